"""LQR and LQI against theory: Riccati equation, cost ½ xᵀPx in the model and in the kernel, optimality, offsets."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose

from quadpend_baselines.controllers.lqr import Lqr, LqrGains, model, output_matrix, riccati, weights
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.gains import tuning
from quadpend_baselines.modelling.linear_model import (
    DISTURBANCE_COLUMNS,
    MODEL_STATE_SIZE,
    STATE_COLUMNS,
    linearise,
)
from quadpend_gym import PAPER, Constant, QuadPendulumVectorEnv, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from tests.helpers.controllers import (
    HOVER,
    disturbance_of,
    hover_states,
    run_policy,
    simulate_with_true_state,
    simulation_of,
)
from tests.helpers.physics import UNEQUAL

PLAIN, INTEGRAL = LqrGains(), LqrGains(integral=0.5)
WIND = disturbance_of((0.1, -0.05, 0.08), (0.02, 0.01, 0.0), (0.05, -0.03, 0.02))


@pytest.mark.parametrize("gains", [PLAIN, INTEGRAL, tuning("lqi").gains], ids=["plain", "integral", "lqi"])
def test_cost_matrix_solves_the_riccati_equation(gains: LqrGains) -> None:
    """P = Q + Kᵀ R K + (A − B K)ᵀ P (A − B K), and K minimises the right side."""
    simulation = simulation_of(UNEQUAL)
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    K, P = riccati(gains, simulation)
    closed = A - B @ K
    assert_allclose(Q + K.T @ R @ K + closed.T @ P @ closed, P, rtol=0.0, atol=1e-11 * np.abs(P).max())
    slope = R @ K - B.T @ P @ closed
    assert_allclose(slope, 0.0, atol=1e-11 * np.abs(R @ K).max())
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0


def states_near_hover(x: Floats) -> Floats:
    """Return states that deviate from hover by the rows of x, shape (n, 18)."""
    state = State(hover_states(len(x)))
    state.array[:, STATE_COLUMNS] += x
    r, v = state.direction, state.direction_rate
    r[:, 2] = np.sqrt(1.0 - np.sum(r[:, :2] ** 2, axis=1))
    v[:, 2] = -np.sum(r[:, :2] * v[:, :2], axis=1) / r[:, 2]
    return state.array


def test_simulated_cost_of_the_kernel_is_that_of_the_cost_matrix_up_to_its_nonlinearity() -> None:
    """The mean cost from x and −x has no odd part, so that its relative error is of second order in the deviation."""
    simulation = Simulation()
    (Q, R), (_, P) = weights(PLAIN, simulation), riccati(PLAIN, simulation)
    x = np.random.default_rng(14).normal(size=MODEL_STATE_SIZE)

    sizes, cost = np.array([0.01, 0.005]), np.zeros(4)

    def add_cost(measurement: Estimate, command: Floats, memory: object) -> None:
        x_k, effort = measurement.state[:, STATE_COLUMNS], command - [PAPER.hover_thrust, 0.0, 0.0, 0.0]
        cost[:] += 0.5 * (np.sum(x_k @ Q * x_k, axis=1) + np.sum(effort @ R * effort, axis=1))

    start = states_near_hover(np.outer([*sizes, *-sizes], x))
    simulate_with_true_state(Lqr(PLAIN, simulation), simulation, start, 1500, callback=add_cost)
    large, small = cost.reshape(2, 2).mean(axis=0) / (0.5 * sizes**2 * (x @ P @ x)) - 1.0
    assert abs(large) < 1e-3
    assert large / small == pytest.approx(4.0, rel=0.1)


def settled(policy: OutputFeedback, wind: Floats, seconds: float = 20.0) -> Floats:
    """Return the tracking error (m) at hover after some time in a constant wind, shape (3,)."""
    constant = Constant(*map(tuple, np.split(wind, 3)))
    env = QuadPendulumVectorEnv(1, wind=constant, autoreset_mode=AutoresetMode.DISABLED, duration=seconds + 1.0)
    steps = round(seconds / env.world.simulation.period)
    return np.asarray(run_policy(policy, env, steps, options={"reference": HOVER})[1][-1][4]["tracking_error"][0])


def test_offset_of_lqr_in_steady_wind_is_that_of_the_linear_model() -> None:
    """x = (I − A + B K)⁻¹ E d; the relative error of this prediction is proportional to the wind."""
    simulation, gains = Simulation(), PLAIN
    A, B, E = linearise(simulation)
    K, _ = riccati(gains, simulation)
    errors = []
    for share in (0.5, 0.25):
        x = np.linalg.solve(np.eye(MODEL_STATE_SIZE) - A + B @ K, E @ (share * WIND)[DISTURBANCE_COLUMNS])
        predicted = output_matrix(PAPER.rod_length) @ x
        offset = settled(OutputFeedback(Lqr, gains, simulation), share * WIND, seconds=12.0)
        errors.append(np.linalg.norm(offset - predicted) / np.linalg.norm(predicted))
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)


def test_lqi_has_no_offset_in_steady_wind() -> None:
    assert_allclose(settled(OutputFeedback(Lqr, tuning("lqi").gains), WIND), 0.0, atol=1e-5)
