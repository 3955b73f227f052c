"""Flat outputs: the kernel follows the trajectory open loop, and statics and thrust direction agree with the model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.modelling import flat_outputs
from quadpend_gym import PAPER, Parameters, Reference, Waypoints
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations, thrust_axis
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST, Disturbance, State
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.tasks.feasibility import demand
from tests.helpers.controllers import CALM, HOVER, disturbance_of, flat_state_and_command
from tests.helpers.physics import UNEQUAL, simulate_period

TIME = 0.3
ON_QUADROTOR = disturbance_of(force=(0.3, -0.2, 0.15), torque=(0.1, -0.05, 0.03))
ON_BOTH = ON_QUADROTOR + disturbance_of(bob_force=(0.05, -0.04, 0.1))
# A climbing circle with an acceleration of 1.4 m/s² and a drifting, oscillating yaw.
CIRCLE = Reference(
    offset=(0.3, 0.1, 2.0, 0.8),
    rate=(0.1, 0.0, 0.3, 0.5),
    amplitude=(1.0, 1.0, 0.0, 0.4),
    frequency=(1.2, 1.2, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.3),
)
VERTICAL_OSCILLATION = Reference(amplitude=(0.0, 0.0, 0.4, 0.5), frequency=(0.0, 0.0, 1.5, 1.0))


def figure_eight(acceleration: float) -> Reference:
    """Return a figure eight of 2 m length with a peak acceleration a in m/s²: ω² = 8 a/(17 radius)."""
    return Reference.figure_eight(1.0, np.sqrt(8.0 * acceleration / 17.0))


def open_loop(reference: Reference, disturbance: Floats, p: Parameters, period: float = 2e-3) -> float:
    """Return the largest deviation of the kernel from the flat state, in any component, under the flat command."""
    state, _ = flat_state_and_command(reference, 0.0, disturbance, p)
    deviation = 0.0
    for step in range(round(TIME / period)):
        _, command = flat_state_and_command(
            reference, (step + 0.5) * period, disturbance, p
        )  # that of the middle of the period
        state = simulate_period(state, command, disturbance, p, period, 1)
        expected, _ = flat_state_and_command(reference, (step + 1) * period, disturbance, p)
        deviation = max(deviation, float(np.abs(state - expected).max()))
    return deviation


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
@pytest.mark.parametrize("disturbance", [CALM, ON_QUADROTOR], ids=["calm", "wind"])
@pytest.mark.parametrize(
    "reference", [HOVER, CIRCLE, VERTICAL_OSCILLATION], ids=["hover", "circle", "vertical oscillation"]
)
def test_open_loop_command_follows_the_reference(
    reference: Reference, disturbance: Floats, parameters: Parameters
) -> None:
    """The unstable pole amplifies errors by 8 in 0.3 s; the remaining error comes from the sampling of the command."""
    assert open_loop(reference, disturbance, parameters) < 5e-7


def test_open_loop_error_on_a_figure_eight_is_that_of_the_neglected_bob_acceleration() -> None:
    """(1) neglects s l r̈_z, which is proportional to tilt³ ω², that is to a⁴ for figure eights of the same size."""
    fast, slow = open_loop(figure_eight(1.0), CALM, PAPER), open_loop(figure_eight(0.5), CALM, PAPER)
    assert fast < 1e-4
    assert fast / slow > 14.0
    assert open_loop(figure_eight(1.0), ON_BOTH, PAPER) < 2e-4


@pytest.mark.parametrize("disturbance", [CALM, ON_QUADROTOR, ON_BOTH], ids=["calm", "on the quadrotor", "on both"])
def test_all_forces_balance_at_hover(disturbance: Floats) -> None:
    """The thrust balances weights and forces of both bodies, the rod those of the bob, and all rates are zero."""
    for p in (PAPER, UNEQUAL):
        state, command = flat_state_and_command(Reference.hover(yaw=1.0), 0.0, disturbance, p)
        s, d, gravity = State(state[0]), Disturbance(disturbance), np.array([0.0, 0.0, p.gravity])
        thrust = command[0, THRUST] * np.array(thrust_axis(Vec3(*s.euler)))
        assert_allclose(thrust, p.total_mass * gravity - d.force - d.bob_force, atol=1e-12)
        assert_allclose(np.cross(s.direction, p.bob_mass * gravity - d.bob_force), 0.0, atol=1e-12)
        assert_allclose(command[0, COMMAND_TORQUE:], -d.torque, atol=1e-12)
        actual = accelerations(state, command, disturbance, p)
        for rate in (s.velocity, s.euler_rate, s.direction_rate, actual.position, actual.euler, actual.direction):
            assert_allclose(rate, np.zeros_like(rate), atol=1e-12)


def demand_and_flat_trajectory(trajectory: Reference | Waypoints, p: Parameters) -> tuple[Floats, Floats]:
    """Thrust, body tilt and pendulum tilt from `feasibility` and from the flat trajectory, each of shape (3, 30)."""
    times, calm = np.linspace(0.1, 1.9, 30), np.tile(CALM, (30, 1))
    needed = demand(trajectory, p, times)
    flat = flat_outputs.flat_trajectory(trajectory.derivatives(times)[:, 2:, :3], calm, p)
    tilt = np.arctan(np.linalg.norm(flat.thrust_tangent[0], axis=-1))
    thrust, pendulum = flat.vertical_thrust[0] / np.cos(tilt), np.arccos(flat.pendulum_vertical[0])
    return np.array([needed.thrust, needed.body_angle, needed.pendulum_angle]), np.array([thrust, tilt, pendulum])


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
def test_the_demand_of_a_circle_is_exact_and_its_error_elsewhere_is_of_third_order(parameters: Parameters) -> None:
    """`feasibility` may not import this module. Both leave out the term l r̈_z, in different equations."""
    assert_allclose(*demand_and_flat_trajectory(CIRCLE, parameters), rtol=1e-12)
    errors = []
    for size in (0.02, 0.01):
        trajectory = Waypoints((0, 1, 2), ((0, 0, 2), (5 * size, 3 * size, 2.2), (2 * size, 8 * size, 2)))
        (_, tilt, pendulum), (_, flat_tilt, flat_pendulum) = demand_and_flat_trajectory(trajectory, parameters)
        assert_allclose(pendulum, flat_pendulum, rtol=1e-7)
        errors.append(np.abs(tilt - flat_tilt).max())
    assert 6.0 < errors[0] / errors[1] < 10.0
    assert errors[1] < 1e-3
