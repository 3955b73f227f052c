"""MPPI plans what it says it plans, does no worse than its feedback, and catches what its feedback drops."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.controllers.lqr import Lqr, riccati, weights
from quadpend_baselines.controllers.mppi import Mppi, MppiMemory
from quadpend_baselines.gains import GAINS, LqrGains, MppiGains
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import PAPER, Parameters, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from tests.helpers.controllers import (
    CALM,
    HOVER,
    flat_state_and_command,
    hover_states,
    measurement_of,
    rotate_states,
    rotate_vectors,
    simulate_with_true_state,
    tilted_pendulum,
    tracking_errors,
    true_estimate,
)
from tests.helpers.physics import UNEQUAL, simulate_period

FEEDBACK = LqrGains(0.4, 1.3, 1.6, 3.5)
GAINS_HERE = MppiGains(FEEDBACK, samples=33, horizon=20, steps_per_period=2, knots=5, spread=0.3, temperature=0.1)
WIND = np.array([0.3, -0.2, 0.15, 0.05, 0.03, 0.0, 0.1, -0.05, 0.03])
CIRCLE = Reference(
    offset=(0.0, 0.0, 2.0, 0.8),
    rate=(0.2, 0.0, 0.3, 0.4),
    amplitude=(1.0, 1.0, 0.0, 0.0),
    frequency=(1.0, 1.0, 0.0, 0.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)


def upset(rows: int, reference: Reference = HOVER, p: Parameters = PAPER) -> Floats:
    """States around a reference, shape (rows, 18), the pendulum leaning up to 0.2 rad."""
    rng = np.random.default_rng(16)
    state = np.repeat(flat_state_and_command(reference, 0.0, CALM, p)[0], rows, axis=0)
    state[:, :12] += 0.1 * rng.normal(size=(rows, 12))
    State(state).direction[:] = State(
        tilted_pendulum(rng.uniform(0.0, 0.2, rows), rng.uniform(0.0, 6.0, rows), rows)
    ).direction
    State(state).direction_rate[:] = 0.0
    return state


def plans_for(gains: MppiGains, rows: int, size: float) -> Floats:
    """Perturbations at the knots, shape (rows, samples, knots, 4)."""
    rng = np.random.default_rng(17)
    return size * Simulation().command_scale * rng.normal(size=(rows, gains.samples, gains.knots, 4))


def paid(law: Mppi, state: Floats, plan: Floats, reference: Reference, wind: Floats, start: float = 0.0) -> float:
    """Equation (2) of one plan, shape (knots, 4), flown in the world against the reference's own flat flight."""
    g, p = law.gains, law.simulation.parameters
    coarse = replace(
        law.simulation,
        period=g.steps_per_period * law.simulation.period,
        substeps=g.steps_per_period * law.simulation.substeps,
    )
    (gain, terminal), (Q, R) = riccati(g.feedback, coarse), weights(g.feedback, coarse)
    scale, total = coarse.command_scale, 0.0
    low, high = scale * [0.0, -1.0, -1.0, -1.0], scale * [2.0, 1.0, 1.0, 1.0]
    for step in range(g.horizon + 1):
        should, wanted = flat_state_and_command(reference, start + step * coarse.period, wind, p)
        off = rotate_state((state - should)[:, STATE_COLUMNS], -state[:, 8])[0]
        if step == g.horizon:
            return total + 0.5 * off @ terminal @ off
        knots = np.linspace(0.0, g.horizon, g.knots)
        change = [np.interp(step, knots, plan[:, component]) for component in range(4)]
        used = np.clip(wanted[0] - gain @ off + change, low, high) - wanted[0]
        total += 0.5 * (off @ Q @ off + used @ R @ used)
        state = simulate_period(state, (wanted[0] + used), wind, p, coarse.period, coarse.substeps)
        s = State(state[0])
        upright, level = s.direction[2], np.cos(s.euler[0]) * np.cos(s.euler[1])
        total += 1e4 * (max(0.6 - upright, 0.0) ** 2 + max(0.3 - level, 0.0) ** 2)
    raise AssertionError


@pytest.mark.parametrize("steps_per_period", [1, 2, 3])
@pytest.mark.parametrize("reference", [HOVER, CIRCLE], ids=["hover", "circle"])
def test_a_plans_cost_is_that_of_flying_it(reference: Reference, steps_per_period: int) -> None:
    """In wind, with all of the plant unlike the paper's; the circle is foreseen as a polynomial of order 6."""
    law = Mppi(replace(GAINS_HERE, steps_per_period=steps_per_period, horizon=15, samples=5), Simulation(UNEQUAL))
    state, plans = upset(3, reference, UNEQUAL), plans_for(law.gains, 3, 0.1)
    measurement = measurement_of(state, reference)
    estimate = true_estimate(measurement, WIND)
    costs = law.costs(estimate, law.reference_horizon(estimate, measurement), plans)
    for row in range(3):
        for sample in range(5):
            true = paid(law, state[row : row + 1], plans[row, sample], reference, WIND)
            assert costs[row, sample] == pytest.approx(true, rel=1e-5 if reference is HOVER else 1e-4)


def commanded(law: Mppi, state: Floats, memory: MppiMemory | None = None, wind: Floats = CALM) -> tuple[Any, Any]:
    """Command and memory beside hover."""
    measurement = measurement_of(state)
    return law.command(
        true_estimate(measurement, wind), measurement, law.initial_memory(len(state)) if memory is None else memory
    )


def test_without_perturbations_it_is_the_linear_feedback_around_the_flight_in_the_wind() -> None:
    """Of the weights of `lqr`, for the period of the horizon."""
    law = Mppi(replace(GAINS_HERE, spread=0.0), Simulation())
    state = upset(6)
    command, memory = commanded(law, state, wind=WIND)
    gain, _ = riccati(FEEDBACK, Simulation(period=0.02))
    should, wanted = flat_state_and_command(HOVER, 0.0, WIND, PAPER)
    off = rotate_state((state - should)[:, STATE_COLUMNS], -state[:, 8])
    assert_allclose(command, wanted - off @ gain.T, atol=1e-6)
    assert_array_equal(memory.perturbation, 0.0)


def test_at_a_low_temperature_the_best_future_is_flown() -> None:
    """The feedback itself where that does well, a better one where it falls; at a high one the mean of all."""
    cold = Mppi(replace(GAINS_HERE, temperature=1e-6), Simulation())
    state = tilted_pendulum(np.repeat([0.05, 0.35], 4), np.arange(8.0), 8)
    measurement = measurement_of(state)
    estimate, first = true_estimate(measurement), cold.initial_memory(8)
    horizon = cold.reference_horizon(estimate, measurement)
    feedback, _ = commanded(Mppi(replace(GAINS_HERE, spread=0.0), Simulation()), state)
    command, _ = commanded(cold, state)
    samples = np.concatenate([np.zeros((8, 1, 5, 4)), cold.perturbations[first.count]], axis=1)
    costs = cold.costs(estimate, horizon, samples)
    for row in range(8):
        best = samples[row, costs[row].argmin()]
        assert_allclose(command[row], feedback[row] + best[0], atol=1e-9)
    assert_array_equal(costs.argmin(axis=1) == 0, np.repeat([True, False], 4))
    hot, _ = commanded(Mppi(replace(GAINS_HERE, temperature=1e9), Simulation()), state)
    assert_allclose(hot, feedback, atol=1e-6)  # for every perturbation there is its opposite


def test_a_plan_moves_on_with_time() -> None:
    """δ is piecewise linear in time: a step later it is the same line, seen from there, and it ends in no change."""
    law = Mppi(replace(GAINS_HERE, spread=0.0, temperature=1e12), Simulation())
    plan = np.random.default_rng(18).normal(size=(1, 5, 4))
    feedback, _ = commanded(law, hover_states())
    command, memory = commanded(law, hover_states(), MppiMemory(plan, np.zeros(1, np.int64)))
    mean = plan * 32.0 / 33.0  # of the 33 futures, one has no δ
    assert_allclose(command - feedback, mean[:, 0], atol=1e-6)
    spacing, ends = 0.1, np.append(mean[0], np.zeros((1, 4)), axis=0)
    later = [np.interp(spacing * np.arange(5) + 0.01, spacing * np.arange(6), ends[:, c]) for c in range(4)]
    assert_allclose(memory.perturbation[0], np.transpose(later), atol=1e-6)


def test_it_is_a_function_of_what_it_knows() -> None:
    """Twice the same, from another instance too; a row alone is the row in a batch but for the last bits of BLAS."""
    state, law = upset(5), Mppi(GAINS_HERE, Simulation())
    batch, memory = commanded(law, state)
    batch, memory = commanded(law, state, memory)
    again, _ = commanded(Mppi(GAINS_HERE, Simulation()), state)
    again, other = commanded(law, state, commanded(Mppi(GAINS_HERE, Simulation()), state)[1])
    assert_array_equal(again, batch)
    assert_array_equal(other.perturbation, memory.perturbation)
    assert_array_equal(memory.count, 2)
    for row in range(5):
        alone = commanded(law, state[row : row + 1])
        alone = commanded(law, state[row : row + 1], alone[1])
        assert_allclose(alone[0][0], batch[row], atol=1e-10)


def test_what_its_feedback_drops_it_catches() -> None:
    """From 20 degrees in any direction the sampled futures find a way that the linear feedback does not."""
    simulation, azimuths = Simulation(), np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    start = tilted_pendulum(0.35, azimuths, 8)
    alone = simulate_with_true_state(Mppi(replace(GAINS_HERE, spread=0.0), simulation), simulation, start, 100)
    assert (State(alone).direction[:, 2] < 0.5).all()
    lowest = []
    caught = simulate_with_true_state(
        Mppi(GAINS_HERE, simulation),
        simulation,
        start,
        300,
        watch=lambda measurement, *_: lowest.append(State(measurement.state).direction[:, 2].min()),
    )
    assert min(lowest) > 0.5
    assert_allclose(caught[:, :12], hover_states(8)[:, :12], atol=0.05)


def offset(law: Any, wind: Floats, seconds: float = 5.0) -> float:
    """How far from the reference the bob hovers after so long in a constant wind, m."""
    error = []
    simulate_with_true_state(
        law,
        law.simulation,
        hover_states(),
        round(seconds / law.simulation.period),
        disturbance=wind,
        watch=lambda measurement, *_: error.append(tracking_errors(measurement, PAPER.rod_length)[0]),
    )
    return float(np.mean(error[-50:]))


def test_it_sees_the_wind() -> None:
    """What it hovers beside its reference by is its perturbations' doing; LQR of the same weights is blown aside."""
    wind = 0.3 * WIND
    assert offset(Lqr(FEEDBACK, Simulation()), wind) > 0.02
    assert offset(Mppi(replace(GAINS_HERE, spread=0.0), Simulation()), wind) < 1e-5
    assert offset(Mppi(replace(GAINS_HERE, spread=0.05), Simulation()), wind) < 1e-3


def test_references_are_tracked() -> None:
    """A turning, climbing circle in wind, to a tenth of a millimetre with little perturbation."""
    law, error = Mppi(replace(GAINS_HERE, spread=0.05), Simulation()), []
    start, _ = flat_state_and_command(CIRCLE, 0.0, WIND, PAPER)
    simulate_with_true_state(
        law,
        law.simulation,
        start,
        200,
        CIRCLE,
        WIND,
        lambda measurement, *_: error.append(tracking_errors(measurement, PAPER.rod_length)[0]),
    )
    assert max(error) < 1e-4


def test_a_turned_world_is_flown_the_same() -> None:
    law, state, angle = Mppi(GAINS_HERE, Simulation()), upset(6), 1.3
    plain, _ = commanded(law, state, wind=WIND)
    wind = np.concatenate([rotate_vectors(WIND[:6].reshape(2, 3), angle).ravel(), WIND[6:]])
    measurement = measurement_of(rotate_states(state, angle), Reference.hover(yaw=angle))
    turned, _ = law.command(true_estimate(measurement, wind), measurement, law.initial_memory(6))
    assert_allclose(turned, plain, atol=1e-8)


@pytest.mark.parametrize(
    ("gains", "sentence"),
    [
        (MppiGains(samples=32), "samples must be odd"),
        (MppiGains(samples=101), "from 3 to 63"),
        (MppiGains(knots=1), "knots must be"),
        (MppiGains(feedback=LqrGains(integral=0.3)), "no integrators"),
    ],
)
def test_what_the_compiled_futures_have_no_room_for_is_refused(gains: MppiGains, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Mppi(gains, Simulation())


def test_the_gains_that_stand_are_those_of_such_a_controller() -> None:
    """An odd number of futures: one without perturbation and pairs of opposites."""
    gains = GAINS["mppi"]
    law = Mppi(gains, Simulation())
    assert law.perturbations.shape == (64, gains.samples - 1, gains.knots, 4)
    assert_allclose(law.perturbations.sum(axis=1), 0.0, atol=1e-12)
