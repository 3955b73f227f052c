"""MPPI: costs of the sampled trajectories, the update of δ, disturbance rejection, and recovery from large tilts."""

from dataclasses import replace

import numpy as np
import pytest

from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.controllers.mppi import Mppi
from quadpend_baselines.controllers.reference_horizon import reference_horizon
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
    measurement_of,
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


@pytest.mark.parametrize("reference", [HOVER, CIRCLE], ids=["hover", "circle"])
def test_cost_of_a_sample_is_that_of_its_simulation(reference: Reference) -> None:
    """With wind and a plant unlike the paper's. MPPI extrapolates the circle by a polynomial of order 6."""
    law, rng = Mppi(replace(GAINS_HERE, horizon=15, samples=5), simulation_of(UNEQUAL)), np.random.default_rng(17)
    state, samples = disturbed_states(3, reference, UNEQUAL), rng.normal(size=(3, 5, 5, COMMAND_SIZE))
    samples *= 0.1 * Simulation().command_scale
    measurement = measurement_of(state, reference)
    estimate = true_estimate(measurement, WIND)
    horizon = reference_horizon(estimate, law.simulation, law.horizon_simulation.period, 15)
    costs = law.costs(estimate, horizon, samples)
    for row in range(3):
        for i in range(5):
            expected = simulated_cost(law, state[row : row + 1], samples[row, i], reference, WIND)
            assert costs[row, i] == pytest.approx(expected, rel=1e-5 if reference is HOVER else 1e-4)
