"""LQR meets its theory: Riccati's equation, the cost ½ xᵀPx in the model and in the kernel, optimality, offsets."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_lyapunov

from quadpend_baselines.controllers.lqr import Lqr, model, output_matrix, riccati, weights
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import GAINS, LqrGains
from quadpend_baselines.modelling.linear_model import DISTURBANCE_COLUMNS, MODEL_STATE_SIZE, STATE_COLUMNS, linearise
from quadpend_gym import PAPER, Constant, QuadPendulumVectorEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from tests.helpers.controllers import (
    HOVER,
    hover_states,
    measurement_of,
    rotate_states,
    rotate_vectors,
    simulate_with_true_state,
    true_estimate,
)
from tests.helpers.physics import UNEQUAL

PLAIN, INTEGRAL = LqrGains(), LqrGains(integral=0.5)
EVERY = {"plain": PLAIN, "integral": INTEGRAL, "lqr": GAINS["lqr"], "lqi": GAINS["lqi"]}
every_gain = pytest.mark.parametrize("gains", EVERY.values(), ids=EVERY.keys())
WIND = np.array([0.1, -0.05, 0.08, 0.02, 0.01, 0.0, 0.05, -0.03, 0.02])


@every_gain
def test_the_cost_matrix_solves_riccatis_equation(gains: LqrGains) -> None:
    """P = Q + Kᵀ R K + (A − B K)ᵀ P (A − B K), and no other gain makes the right side smaller."""
    simulation = Simulation(UNEQUAL)
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    K, P = riccati(gains, simulation)
    closed = A - B @ K
    assert_allclose(Q + K.T @ R @ K + closed.T @ P @ closed, P, rtol=0.0, atol=1e-11 * np.abs(P).max())
    slope = R @ K - B.T @ P @ closed
    assert_allclose(slope, 0.0, atol=1e-11 * np.abs(R @ K).max())
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0


@every_gain
def test_the_linear_flight_costs_what_the_matrix_says(gains: LqrGains) -> None:
    simulation = Simulation()
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    K, P = riccati(gains, simulation)
    x = np.random.default_rng(12).normal(size=len(A))
    promised, paid = 0.5 * x @ P @ x, 0.0
    for _ in range(5000):
        u = -K @ x
        paid += 0.5 * (x @ Q @ x + u @ R @ u)
        x = A @ x + B @ u
    assert paid == pytest.approx(promised, rel=1e-9)


@every_gain
def test_any_other_gain_costs_more_from_every_start(gains: LqrGains) -> None:
    simulation = Simulation()
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    K, P = riccati(gains, simulation)
    rng = np.random.default_rng(13)
    for _ in range(5):
        other = K * (1.0 + 0.01 * rng.normal(size=K.shape))
        closed = A - B @ other
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
        cost = solve_discrete_lyapunov(closed.T, Q + other.T @ R @ other)
        more = np.linalg.eigvalsh(cost - P)
        assert more.min() > -1e-7 * more.max()
        assert more.max() > 0.0


def deviating(x: Floats) -> Floats:
    """States beside hover by rows of x, shape (n, 18)."""
    state = State(hover_states(len(x)))
    state.array[:, STATE_COLUMNS] += x
    r, v = state.direction, state.direction_rate
    r[:, 2] = np.sqrt(1.0 - np.sum(r[:, :2] ** 2, axis=1))
    v[:, 2] = -np.sum(r[:, :2] * v[:, :2], axis=1) / r[:, 2]
    return state.array


def test_the_kernels_flight_costs_what_the_matrix_says_up_to_its_nonlinearity() -> None:
    """From ±x the costs' odd parts cancel; what remains beside ½ xᵀPx is of second order in the deviation."""
    simulation = Simulation()
    (Q, R), (_, P) = weights(PLAIN, simulation), riccati(PLAIN, simulation)
    x = np.random.default_rng(14).normal(size=MODEL_STATE_SIZE)

    def excess(size: float) -> float:
        paid = 0.0

        def pay(measurement: object, command: Floats, memory: object) -> None:
            nonlocal paid
            off, effort = measurement.state[:, STATE_COLUMNS], command - [PAPER.hover_thrust, 0.0, 0.0, 0.0]  # type: ignore[attr-defined]
            paid += 0.25 * (np.sum(off @ Q * off) + np.sum(effort @ R * effort))

        start = deviating(size * np.stack([x, -x]))
        simulate_with_true_state(Lqr(PLAIN, simulation), simulation, start, 1500, watch=pay)
        return paid / (0.5 * size**2 * x @ P @ x) - 1.0

    large, small = excess(0.01), excess(0.005)
    assert abs(large) < 1e-3
    assert large / small == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("gains", [PLAIN, INTEGRAL], ids=["plain", "integral"])
def test_it_is_the_feedback_of_its_matrix_beside_hover(gains: LqrGains) -> None:
    """In every component, and turned with the world: K is that of the heading's axes, σ stands in the world's."""
    simulation = Simulation(UNEQUAL)
    law, (K, _) = Lqr(gains, simulation), riccati(gains, simulation)
    x, sum_of_errors = 1e-3 * np.eye(MODEL_STATE_SIZE), np.array([0.01, -0.02, 0.03])
    expected = x @ K[:, :MODEL_STATE_SIZE].T + (K[:, MODEL_STATE_SIZE:] @ sum_of_errors if gains.integral else 0.0)
    for angle in (0.0, 2.0):
        measurement = measurement_of(rotate_states(deviating(x), angle), Reference.hover(yaw=angle))
        memory = np.zeros((MODEL_STATE_SIZE, 3)) + rotate_vectors(sum_of_errors, angle)
        # The heading is the body's own: a yaw error turns it against the sum.
        rows = np.abs(x[:, 8]) == 0.0
        command, _ = law.command(true_estimate(measurement), measurement, memory)
        assert_allclose((command - [UNEQUAL.hover_thrust, 0.0, 0.0, 0.0])[rows], -expected[rows], atol=1e-9)


def test_each_tolerance_counts_as_much_as_the_others() -> None:
    """Off by its tolerance in any one thing costs a half a step: in position by the quadrotor's or the bob's way."""
    gains, length = LqrGains(0.2, 0.7, 0.4, 2.5, effort=0.8, integral=0.3), PAPER.rod_length
    Q, R = weights(gains, Simulation())
    tolerances = [(index, gains.position) for index in (0, 1, 2)] + [(index, gains.velocity) for index in (3, 4, 5)]
    tolerances += [(index, gains.angle) for index in (6, 7, 8)] + [(index, gains.angle_rate) for index in (9, 10, 11)]
    tolerances += [(index, gains.position / length) for index in (12, 13)]
    tolerances += [(index, gains.velocity / length) for index in (14, 15)]
    tolerances += [(index, gains.integral) for index in (16, 17, 18)]
    for index, tolerance in tolerances:
        assert Q[index, index] * tolerance**2 == pytest.approx(1.0)
    assert_allclose(np.diag(R) * (gains.effort * Simulation().command_scale) ** 2, 1.0)
    still = np.zeros(len(Q))
    still[[0, 12]] = 0.1, -0.1 / length  # the bob stays, and so does the cost
    assert still @ Q @ still == pytest.approx(0.0, abs=1e-12)


def settled(policy: OutputFeedback, wind: Floats, seconds: float = 20.0) -> Floats:
    """Tracking error (m) of hovering after so long in a constant wind, shape (3,)."""
    blowing = Constant(force=tuple(wind[0:3]), bob_force=tuple(wind[3:6]), torque=tuple(wind[6:9]))
    env = QuadPendulumVectorEnv(1, wind=blowing, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=None)
    observation, _ = env.reset(seed=3, options={"reference": HOVER})
    memory = None
    for _ in range(round(seconds / env.world.simulation.period)):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
    return np.asarray(info["tracking_error"][0])


def test_in_steady_wind_lqr_keeps_the_offset_of_the_linear_model() -> None:
    """x = (I − A + B K)⁻¹ E d; what is left is of first order in the wind: half of it at half the wind."""
    simulation, gains = Simulation(), PLAIN
    A, B, E = linearise(simulation)
    K, _ = riccati(gains, simulation)
    apart = []
    for share in (0.5, 0.25):
        x = np.linalg.solve(np.eye(MODEL_STATE_SIZE) - A + B @ K, E @ (share * WIND)[DISTURBANCE_COLUMNS])
        predicted = output_matrix(PAPER.rod_length) @ x
        offset = settled(OutputFeedback(Lqr, gains, simulation), share * WIND)
        apart.append(np.linalg.norm(offset - predicted) / np.linalg.norm(predicted))
    assert apart[1] < 0.01
    assert apart[0] / apart[1] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("gains", [INTEGRAL, GAINS["lqi"]], ids=["integral", "lqi"])
def test_in_steady_wind_lqi_keeps_no_offset(gains: LqrGains) -> None:
    assert_allclose(settled(OutputFeedback(Lqr, gains), WIND), 0.0, atol=1e-5)


def test_integrators_take_the_error_in_the_worlds_axes_up_to_their_bound() -> None:
    simulation, rows = Simulation(), 2
    limit = 0.05
    law = Lqr(replace(INTEGRAL, integral_limit=limit), simulation)
    state = hover_states(rows)
    State(state).position[:] += [0.02, -0.01, 0.03]
    State(state).euler[1, 2] = 2.0
    measurement = measurement_of(state, HOVER)._replace(yaw_reference=State(state).euler[:, 2:] * [1.0, 0.0, 0.0])
    memory = law.initial_memory(rows)
    for step in range(1, 601):
        _, memory = law.command(true_estimate(measurement), measurement, memory)
        if step in (1, 100):
            assert_allclose(memory, np.tile(step * simulation.period * np.array([0.02, -0.01, 0.03]), (rows, 1)))
    assert_allclose(memory, np.tile([limit, -limit, limit], (rows, 1)))


def test_integrators_wait_while_a_command_is_beyond_the_actuators() -> None:
    """Row 0 turns too fast for the torque there is, row 1 does not."""
    simulation = Simulation()
    law, state = Lqr(INTEGRAL, simulation), hover_states(2)
    State(state).position[:] += [0.02, 0.0, 0.0]
    State(state).euler_rate[0] = [50.0, 0.0, 0.0]
    measurement = measurement_of(state)
    command, memory = law.command(true_estimate(measurement), measurement, law.initial_memory(2))
    assert abs(command[0, 1]) > simulation.actuators.roll_pitch_torque
    assert_array_equal(memory[0], 0.0)
    assert memory[1, 0] > 0.0
