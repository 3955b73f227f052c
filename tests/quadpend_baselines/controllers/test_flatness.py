"""Flatness-based control: closed-loop poles, exact tracking, no steady offset, and limits of the cascade."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose

from quadpend_baselines.controllers.flatness import Flatness, FlatnessGains
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, STATE_COLUMNS
from quadpend_gym import PAPER, Constant, QuadPendulumVectorEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from tests.helpers.controllers import (
    CALM,
    HOVER,
    disturbance_of,
    flat_state_and_command,
    run_law,
    run_policy,
    simulate_with_true_state,
    simulation_of,
    tilted_pendulum,
    tracking_distance,
)
from tests.helpers.physics import UNEQUAL, rates

GAINS = FlatnessGains()
# No limit is active, and the bandwidths are those near the desired direction.
LINEAR = replace(GAINS, acceleration=1e9, velocity=1e9, lean=1.5, near=1e9)
WIND = disturbance_of(force=(0.5, -0.3, 0.4), bob_force=(0.0, 0.0, 0.4), torque=(0.1, 0.2, 0.03))
CIRCLE = Reference(
    offset=(0.0, 0.0, 2.0, 0.5),
    rate=(0.0, 0.0, 0.1, 0.3),
    amplitude=(1.0, 1.0, 0.0, 0.3),
    frequency=(1.0, 1.0, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)


def characteristic(law: Flatness, yaw: float, disturbance: Floats, step: float = 1e-5) -> Floats:
    """Return the characteristic polynomial of ẋ = f(x, law(x)) at hover in constant wind, by central differences."""
    p, reference = law.simulation.parameters, Reference.hover(yaw=yaw)
    steps = step * np.concatenate([np.eye(MODEL_STATE_SIZE), -np.eye(MODEL_STATE_SIZE)])
    state = np.repeat(flat_state_and_command(reference, 0.0, disturbance, p)[0], len(steps), axis=0)
    state[:, STATE_COLUMNS] += steps
    s = State(state)
    s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
    s.direction_rate[:, 2] = -np.sum((s.direction * s.direction_rate)[:, :2], axis=1) / s.direction[:, 2]
    command, _ = run_law(law, state, wind=disturbance, reference=reference)
    plus, minus = np.split(rates(state, command, disturbance, p).array[:, STATE_COLUMNS], 2)
    return np.asarray(np.poly((plus - minus).T / (2.0 * step)))


def pole_pairs(*bandwidths: float, damping: float = GAINS.damping) -> Floats:
    """Return the coefficients of the product of all s² + 2ζω s + ω², highest power first."""
    polynomial = np.array([1.0])
    for w in bandwidths:
        polynomial = np.convolve(polynomial, [1.0, 2.0 * damping * w, w * w])
    return polynomial


@pytest.mark.parametrize("disturbance", [CALM, WIND], ids=["calm", "wind"])
@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_closed_loop_has_the_designed_poles(disturbance: Floats, yaw: float) -> None:
    """The poles are those of continuous time and depend neither on the heading nor on the equilibrium tilt in wind."""
    law = Flatness(LINEAR, simulation_of(UNEQUAL))
    designed = pole_pairs(2.5, 7.0, 20.0, 2.5, 7.0, 20.0, 6.0, 6.0)  # x, y, height and yaw
    assert_allclose(characteristic(law, yaw, disturbance), designed, rtol=1e-6)


def test_bandwidths_are_scheduled_between_near_and_far() -> None:
    """Near, far, and at η₀ the command equals that of fixed fast, slow, and mean bandwidths."""
    simulation, angle = Simulation(), 0.01

    def command(gains: FlatnessGains) -> Floats:
        return run_law(Flatness(gains, simulation), tilted_pendulum(angle, 0.7))[0]

    def fixed(pendulum: float, attitude: float) -> FlatnessGains:
        far = {"far_pendulum_bandwidth": pendulum, "far_attitude_bandwidth": attitude}
        return replace(GAINS, pendulum_bandwidth=pendulum, attitude_bandwidth=attitude, **far)

    for near, bandwidths in ((1e6, (7.0, 20.0)), (1e-8, (4.5, 8.0)), (np.tan(angle), (5.75, 14.0))):
        assert_allclose(command(replace(GAINS, near=near)), command(fixed(*bandwidths)), rtol=1e-6)


def test_circles_are_tracked_to_micrometres() -> None:
    """The remaining error comes from the piecewise constant command and is halved with the period."""
    errors = []
    for period in (0.01, 0.005):
        simulation, error = Simulation(period=period), [0.0]
        start, _ = flat_state_and_command(CIRCLE, 0.0, CALM, PAPER)

        def record(measurement: Estimate, *_: object, error: list[float] = error) -> None:
            error.append(tracking_distance(measurement, PAPER.rod_length)[0])

        law = Flatness(GAINS, simulation)
        simulate_with_true_state(law, simulation, start, round(3.0 / period), CIRCLE, callback=record)
        errors.append(max(error))
    assert errors[0] < 3e-6
    assert errors[1] < 0.6 * errors[0] + 1e-12


def test_steady_wind_leaves_no_offset() -> None:
    wind = Constant((0.1, 0.0, -0.2), bob_force=(0.0, 0.05, 0.0), torque=(0.05, -0.03, 0.02))
    env = QuadPendulumVectorEnv(4, wind=wind, autoreset_mode=AutoresetMode.DISABLED)
    _, results = run_policy(OutputFeedback(Flatness, GAINS), env, 800, options={"reference": HOVER})
    assert_allclose(results[-1][4]["tracking_error"], 0.0, atol=1e-5)
