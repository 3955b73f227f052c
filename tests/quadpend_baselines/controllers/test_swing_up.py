"""The swing-up: its plan obeys the simulation, and it ends upright at the reference from any direction and in wind."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines import controller
from quadpend_baselines.controllers.swing_up import tracked_plan
from quadpend_baselines.gains import tuning
from quadpend_gym import Simulation, State
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.evaluation.episodes import run_episodes
from tests.helpers.settling import settling_times


def test_the_plan_is_a_flight_of_the_simulation_from_hanging_to_upright() -> None:
    states, actions, _ = tracked_plan(tuning("swing-up").gains, Simulation())
    simulation = Simulation()
    assert_allclose(State(states[0]).direction, (0.0, 0.0, -1.0), atol=1e-6)
    assert_allclose(State(states[-1]).direction, (0.0, 0.0, 1.0), atol=1e-6)
    for end in (states[0], states[-1]):
        assert_allclose(end[:12], 0.0, atol=1e-6)
        assert_allclose(State(end).direction_rate, 0.0, atol=1e-6)
    assert np.abs(actions).max() <= 0.8 + 1e-6
    parameters = np.tile(simulation.parameters.as_array(), (len(actions), 1))
    following, calm = states[:-1].copy(), np.zeros((len(actions), DISTURBANCE_SIZE))
    advance(following, plant_of(simulation).command(actions), calm, parameters, simulation.period, simulation.substeps)
    assert_allclose(following, states[1:], atol=2e-6)


@pytest.mark.parametrize("vehicle", [(), ("hummingbird", "body_rates")], ids=["paper", "hummingbird"])
@pytest.mark.parametrize(("name", "share"), [("swing_up", 0.99), ("swing_up_breeze", 0.95)])
def test_hanging_pendulums_are_upright_within_five_seconds(name: str, share: float, vehicle: tuple[str, ...]) -> None:
    scenario = SCENARIOS[name].with_vehicle(*vehicle)
    results = run_episodes([controller("swing-up")], scenario, 100, 1_000_000)
    assert np.mean(settling_times(results.survived, results.error, 0.01) <= 5.0) >= share


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(np.array([[True, True, True, True, False]]), np.array([error]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])
