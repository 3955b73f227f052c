"""The flat flight is one: the kernel follows it open loop, and statics and the thrust's own axis agree with it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.modelling import flat_outputs, taylor
from quadpend_gym import PAPER, Parameters, Reference
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations, thrust_axis
from quadpend_gym.physics.state import State
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.tasks import StartSettings, Task
from tests.helpers.controllers import CALM, HOVER, flat_state_and_command
from tests.helpers.envs import make_unwrapped
from tests.helpers.physics import UNEQUAL, simulate_period

TIME = 0.3
ON_QUADROTOR = np.array([0.3, -0.2, 0.15, 0.0, 0.0, 0.0, 0.1, -0.05, 0.03])
ON_BOTH = ON_QUADROTOR + np.array([0.0, 0.0, 0.0, 0.05, -0.04, 0.1, 0.0, 0.0, 0.0])
# Circling at 1.4 m/s² while the yaw drifts and swings, and climbing.
CIRCLE = Reference(
    offset=(0.3, 0.1, 2.0, 0.8),
    rate=(0.1, 0.0, 0.3, 0.5),
    amplitude=(1.0, 1.0, 0.0, 0.4),
    frequency=(1.2, 1.2, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.3),
)
BOBBING = Reference(amplitude=(0.0, 0.0, 0.4, 0.5), frequency=(0.0, 0.0, 1.5, 1.0))


def eight(acceleration: float) -> Reference:
    """A figure eight, 2 m long, with this peak acceleration in m/s²: ω² = 8 a/(17 radius)."""
    return Reference.figure_eight(1.0, np.sqrt(8.0 * acceleration / 17.0))


def open_loop(reference: Reference, disturbance: Floats, p: Parameters, period: float = 2e-3) -> float:
    """How far the kernel strays from the flat state, in any component, under the flat command alone."""
    state, _ = flat_state_and_command(reference, 0.0, disturbance, p)
    strayed = 0.0
    for step in range(round(TIME / period)):
        _, command = flat_state_and_command(
            reference, (step + 0.5) * period, disturbance, p
        )  # the middle stands for its period
        state = simulate_period(state, command, disturbance, p, period, 1)
        should, _ = flat_state_and_command(reference, (step + 1) * period, disturbance, p)
        strayed = max(strayed, float(np.abs(state - should).max()))
    return strayed


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
@pytest.mark.parametrize("disturbance", [CALM, ON_QUADROTOR], ids=["calm", "wind"])
@pytest.mark.parametrize("reference", [HOVER, CIRCLE, BOBBING], ids=["hover", "circle", "bobbing"])
def test_the_command_alone_flies_the_reference(
    reference: Reference, disturbance: Floats, parameters: Parameters
) -> None:
    """The unstable pole would make 8 of each error in the 0.3 s; what is left is the command's staircase."""
    assert open_loop(reference, disturbance, parameters) < 5e-7


def test_what_is_left_is_of_the_second_order_in_the_commands_staircase() -> None:
    coarse, fine = (open_loop(CIRCLE, ON_QUADROTOR, PAPER, period) for period in (1e-2, 5e-3))
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


def test_a_figure_eight_is_flown_but_for_the_bobs_rise() -> None:
    """Left out of (1) is s l r̈_z, the tilt's third power times ω²: of a, at the same size, it is the fourth power."""
    hard, soft = open_loop(eight(1.0), CALM, PAPER), open_loop(eight(0.5), CALM, PAPER)
    assert hard < 1e-4
    assert hard / soft > 14.0
    assert open_loop(eight(1.0), ON_BOTH, PAPER) < 2e-4


@pytest.mark.parametrize("disturbance", [CALM, ON_QUADROTOR, ON_BOTH], ids=["calm", "on the quadrotor", "on both"])
def test_hovering_balances_every_force(disturbance: Floats) -> None:
    """Statics: the thrust carries both weights and winds, the rod the bob's, and nothing turns."""
    for p in (PAPER, UNEQUAL):
        state, command = flat_state_and_command(Reference.hover(yaw=1.0), 0.0, disturbance, p)
        s, weight = State(state[0]), np.array([0.0, 0.0, p.gravity])
        thrust = command[0, 0] * np.array(thrust_axis(Vec3(*s.euler)))
        assert_allclose(thrust, p.total_mass * weight - disturbance[0:3] - disturbance[3:6], atol=1e-12)
        assert_allclose(np.cross(s.direction, p.bob_mass * weight - disturbance[3:6]), 0.0, atol=1e-12)
        assert_allclose(command[0, 1:], -disturbance[6:9], atol=1e-12)
        actual = accelerations(state, command, disturbance, p)
        for rate in (s.velocity, s.euler_rate, s.direction_rate, actual.position, actual.euler, actual.direction):
            assert_allclose(rate, np.zeros_like(rate), atol=1e-12)


def test_the_bob_and_the_height_are_where_the_reference_is() -> None:
    for time in (0.0, 0.7):
        state, _ = flat_state_and_command(CIRCLE, time, ON_BOTH, UNEQUAL)
        s, should = State(state[0]), CIRCLE.derivatives(time)
        for order, (place, lean) in enumerate([(s.position, s.direction), (s.velocity, s.direction_rate)]):
            flat = [*(place + UNEQUAL.rod_length * lean)[:2], place[2]]
            assert_allclose(flat, should[order, :3], atol=1e-12)
        assert_allclose([s.euler[2], s.euler_rate[2]], should[:2, 3])
        assert_allclose([s.direction @ s.direction, s.direction @ s.direction_rate], [1.0, 0.0], atol=1e-12)


def random_attitudes(rows: int) -> Floats:
    """Jets of roll, pitch and yaw up to the second order, shape (3, rows, 3), tilted by up to 1 rad each."""
    rng = np.random.default_rng(8)
    value = rng.uniform([-1.0, -1.0, -4.0], [1.0, 1.0, 4.0], (rows, 3))
    return taylor.from_derivatives(value, *rng.normal(size=(2, rows, 3)))


def test_lean_and_attitude_are_inverses_with_their_rates() -> None:
    euler = random_attitudes(50)
    yaw = euler[..., 2]
    assert_allclose(
        flat_outputs.attitude_from_tangent(flat_outputs.tangent_from_attitude(euler), yaw), euler, atol=1e-10
    )
    lean = 0.7 * np.random.default_rng(9).normal(size=(3, 50, 2))
    assert_allclose(flat_outputs.tangent_from_attitude(flat_outputs.attitude_from_tangent(lean, yaw)), lean, atol=1e-10)


def test_the_lean_is_that_of_the_dynamics_thrust_axis() -> None:
    """(5) against equation (1) of `dynamics`, and its rates against differences."""
    euler = random_attitudes(20)
    lean = flat_outputs.tangent_from_attitude(euler)

    def along(time: float) -> Floats:
        axes = np.array([thrust_axis(Vec3(*angles)) for angles in euler[0] + time * euler[1] + time**2 * euler[2]])
        return np.asarray(axes[:, :2] / axes[:, 2:])

    step = 1e-4
    before, now, after = along(-step), along(0.0), along(step)
    assert_allclose(lean[0], now, rtol=1e-12)
    scale = np.abs(lean[1:]).max(axis=(1, 2))
    assert_allclose(lean[1] / scale[0], (after - before) / (2.0 * step) / scale[0], atol=1e-5)
    assert_allclose(lean[2] / scale[1], (after - 2.0 * now + before) / step**2 / 2.0 / scale[1], atol=1e-5)


def test_starts_without_deviation_are_flat_to_first_order() -> None:
    """Random starts follow the reference to first order in its motion: half of it leaves a quarter or less."""
    exact = StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    apart = {}
    for size in (0.4, 0.2, 0.1):
        reference = Reference(
            offset=(0.0, 0.0, 2.0, 0.9),
            amplitude=(size, size, size, size),
            frequency=(1.5, 2.0, 1.0, 1.2),
            phase=(1.0, 0.2, 0.5, 0.4),
        )
        env = make_unwrapped(task=Task(start=exact))
        env.reset(seed=0, options={"reference": reference})
        flat, _ = flat_state_and_command(reference, 0.0, CALM, PAPER)
        apart[size] = float(np.abs(env.state.array - flat[0]).max())
    assert apart[0.1] < 3e-4
    assert apart[0.4] / apart[0.2] > 3.0
    assert apart[0.2] / apart[0.1] > 3.5


def test_rows_are_flown_each_for_itself() -> None:
    """A batch of unlike references and winds is what its rows are alone."""
    rng = np.random.default_rng(10)
    reference, yaw, wind = rng.normal(size=(6, 5, 3)), rng.normal(size=(6, 3)), 0.2 * rng.normal(size=(6, 9))
    batch = flat_outputs.state_and_command(flat_outputs.flat_trajectory(reference, wind, PAPER), yaw, wind, PAPER)
    for row in range(6):
        i = slice(row, row + 1)
        flight = flat_outputs.flat_trajectory(reference[i], wind[i], PAPER)
        alone = flat_outputs.state_and_command(flight, yaw[i], wind[i], PAPER)
        for one, many in zip(alone, batch, strict=True):
            assert_allclose(one, many[i], rtol=1e-12, atol=1e-12)
