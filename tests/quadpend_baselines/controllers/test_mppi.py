"""MPPI: costs of the sampled trajectories, the update of δ, disturbance rejection, and recovery from large tilts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.controllers.mppi import Mppi, MppiMemory
from quadpend_baselines.gains import LqrGains, MppiGains
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import PAPER, Parameters, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_FIELDS, State
from tests.helpers.controllers import (
    CALM,
    HOVER,
    disturbance_of,
    flat_state_and_command,
    hover_states,
    measurement_of,
    simulate_with_true_state,
    simulation_of,
    tilted_pendulum,
    true_estimate,
)
from tests.helpers.physics import UNEQUAL, simulate_period

FEEDBACK = LqrGains(0.4, 1.3, 1.6, 3.5)
GAINS_HERE = MppiGains(FEEDBACK, samples=33, horizon=20, steps_per_period=2, knots=5, spread=0.3, temperature=0.1)
WIND = disturbance_of((0.3, -0.2, 0.15), (0.05, 0.03, 0.0), (0.1, -0.05, 0.03))
CIRCLE = Reference(
    offset=(0.0, 0.0, 2.0, 0.8),
    rate=(0.2, 0.0, 0.3, 0.4),
    amplitude=(1.0, 1.0, 0.0, 0.0),
    frequency=(1.0, 1.0, 0.0, 0.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)


def disturbed_states(rows: int, reference: Reference = HOVER, p: Parameters = PAPER) -> Floats:
    """Return random states near a reference, shape (rows, 18), with pendulum tilts up to 0.2 rad."""
    rng = np.random.default_rng(16)
    state = np.repeat(flat_state_and_command(reference, 0.0, CALM, p)[0], rows, axis=0)
    state[:, : STATE_FIELDS["direction"].start] += 0.1 * rng.normal(size=(rows, 12))
    State(state).direction[:] = State(
        tilted_pendulum(rng.uniform(0.0, 0.2, rows), rng.uniform(0.0, 6.0, rows), rows)
    ).direction
    State(state).direction_rate[:] = 0.0
    return state


def random_samples(gains: MppiGains, rows: int, size: float) -> Floats:
    """Return random δ at the knots, shape (rows, samples, knots, 4)."""
    rng = np.random.default_rng(17)
    return size * Simulation().command_scale * rng.normal(size=(rows, gains.samples, gains.knots, 4))


def simulated_cost(
    law: Mppi, state: Floats, sample: Floats, reference: Reference, wind: Floats, start: float = 0.0
) -> float:
    """Return the cost (2) of one sample, shape (knots, 4), from a simulation in the world frame."""
    g, p = law.gains, law.simulation.parameters
    simulation = replace(
        law.simulation,
        period=g.steps_per_period * law.simulation.period,
        substeps=g.steps_per_period * law.simulation.substeps,
    )
    (gain, terminal), (Q, R) = riccati(g.feedback, simulation), weights(g.feedback, simulation)
    scale, cost = simulation.command_scale, 0.0
    low, high = scale * [0.0, -1.0, -1.0, -1.0], scale * [2.0, 1.0, 1.0, 1.0]
    for step in range(g.horizon + 1):
        x_d, u_d = flat_state_and_command(reference, start + step * simulation.period, wind, p)
        x = rotate_state((state - x_d)[:, STATE_COLUMNS], -State(state).euler[:, 2])[0]
        if step == g.horizon:
            return cost + 0.5 * x @ terminal @ x
        knots = np.linspace(0.0, g.horizon, g.knots)
        delta = [np.interp(step, knots, sample[:, component]) for component in range(COMMAND_SIZE)]
        u = np.clip(u_d[0] - gain @ x + delta, low, high) - u_d[0]
        cost += 0.5 * (x @ Q @ x + u @ R @ u)
        state = simulate_period(state, (u_d[0] + u), wind, p, simulation.period, simulation.substeps)
        s = State(state[0])
        pendulum, body = s.direction[2], np.cos(s.euler[0]) * np.cos(s.euler[1])
        cost += 1e4 * (max(0.6 - pendulum, 0.0) ** 2 + max(0.3 - body, 0.0) ** 2)
    raise AssertionError


@pytest.mark.parametrize("steps_per_period", [1, 2, 3])
@pytest.mark.parametrize("reference", [HOVER, CIRCLE], ids=["hover", "circle"])
def test_cost_of_a_sample_is_that_of_its_simulation(reference: Reference, steps_per_period: int) -> None:
    """With wind and a plant unlike the paper's. MPPI extrapolates the circle by a polynomial of order 6."""
    law = Mppi(replace(GAINS_HERE, steps_per_period=steps_per_period, horizon=15, samples=5), simulation_of(UNEQUAL))
    state, samples = disturbed_states(3, reference, UNEQUAL), random_samples(law.gains, 3, 0.1)
    measurement = measurement_of(state, reference)
    estimate = true_estimate(measurement, WIND)
    costs = law.costs(estimate, law.reference_horizon(estimate, measurement), samples)
    for row in range(3):
        for i in range(5):
            expected = simulated_cost(law, state[row : row + 1], samples[row, i], reference, WIND)
            assert costs[row, i] == pytest.approx(expected, rel=1e-5 if reference is HOVER else 1e-4)


def run_law(law: Mppi, state: Floats, memory: MppiMemory | None = None, wind: Floats = CALM) -> tuple[Any, Any]:
    """Return command and memory of a law for states near the hover reference."""
    measurement = measurement_of(state)
    return law.command(
        true_estimate(measurement, wind), measurement, law.initial_memory(len(state)) if memory is None else memory
    )


def test_a_low_temperature_selects_the_best_sample_and_a_high_one_the_mean() -> None:
    """The best sample is the linear feedback at a small tilt and a perturbed one at a tilt that it cannot recover."""
    cold = Mppi(replace(GAINS_HERE, temperature=1e-6), Simulation())
    state = tilted_pendulum(np.repeat([0.05, 0.35], 4), np.arange(8.0), 8)
    measurement = measurement_of(state)
    estimate, first = true_estimate(measurement), cold.initial_memory(8)
    horizon = cold.reference_horizon(estimate, measurement)
    feedback, _ = run_law(Mppi(replace(GAINS_HERE, spread=0.0), Simulation()), state)
    command, _ = run_law(cold, state)
    samples = np.concatenate([np.zeros((8, 1, 5, 4)), cold.perturbations[first.updates]], axis=1)
    costs = cold.costs(estimate, horizon, samples)
    for row in range(8):
        best = samples[row, costs[row].argmin()]
        assert_allclose(command[row], feedback[row] + best[0], atol=1e-9)
    assert_array_equal(costs.argmin(axis=1) == 0, np.repeat([True, False], 4))
    hot, _ = run_law(Mppi(replace(GAINS_HERE, temperature=1e9), Simulation()), state)
    assert_allclose(hot, feedback, atol=1e-6)  # the perturbations sum to zero


def test_the_knots_move_forward_by_one_control_step() -> None:
    """δ is piecewise linear in time and zero after its last knot; the next step evaluates the same function later."""
    law = Mppi(replace(GAINS_HERE, spread=0.0, temperature=1e12), Simulation())
    delta = np.random.default_rng(18).normal(size=(1, 5, 4))
    feedback, _ = run_law(law, hover_states())
    command, memory = run_law(law, hover_states(), MppiMemory(delta, np.zeros(1, np.int64)))
    mean = delta * 32.0 / 33.0  # one of the 33 samples has δ = 0
    assert_allclose(command - feedback, mean[:, 0], atol=1e-6)
    spacing, values = 0.1, np.append(mean[0], np.zeros((1, 4)), axis=0)
    later = [np.interp(spacing * np.arange(5) + 0.01, spacing * np.arange(6), values[:, c]) for c in range(4)]
    assert_allclose(memory.perturbation[0], np.transpose(later), atol=1e-6)


def test_mppi_recovers_from_tilts_that_the_linear_feedback_does_not() -> None:
    """The start is at rest with a tilt of 20° in any direction."""
    simulation, azimuths = Simulation(), np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    start = tilted_pendulum(0.35, azimuths, 8)
    feedback_only = simulate_with_true_state(Mppi(replace(GAINS_HERE, spread=0.0), simulation), simulation, start, 100)
    assert (State(feedback_only).direction[:, 2] < 0.5).all()
    lowest = []
    final = simulate_with_true_state(
        Mppi(GAINS_HERE, simulation),
        simulation,
        start,
        300,
        callback=lambda measurement, *_: lowest.append(State(measurement.state).direction[:, 2].min()),
    )
    assert min(lowest) > 0.5
    pose = slice(0, STATE_FIELDS["direction"].start)
    assert_allclose(final[:, pose], hover_states(8)[:, pose], atol=0.05)
