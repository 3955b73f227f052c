"""Settling times and recovery, tolerated delays, and the time of a call."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.measures import call_time, delay_budget, recovery, settling_times
from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario, find_scenario
from tests.helpers.policies import synthetic_results


def test_recovery_is_the_share_that_settles_and_when() -> None:
    results = synthetic_results(np.ones(3), [True, True, False])
    results.error[:] = 0.5
    results.error[0, 0, 200:] = results.error[0, 2, 100:] = 0.01
    share, time = recovery(results, 0.01)
    assert share.value == pytest.approx(100.0 / 3.0)
    assert time.value == pytest.approx(2.0)


def test_the_delay_budget_is_where_a_policy_that_is_not_told_begins_to_fall() -> None:
    """LQR of the vehicle with torques tolerates some delay, and its linear loop about as much."""
    scenario = replace(find_scenario("flight_breeze"), duration=4.0)
    budget = delay_budget(controller("lqr"), scenario, 10, longest=0.2)
    assert 0.01 < budget < 0.2
    assert budget / 0.0025 == pytest.approx(round(budget / 0.0025))
    assert delay_budget(controller("lqr"), scenario, 10, longest=0.0025) == np.inf
    assert delay_budget(controller("lqr"), replace(scenario, wind={"kind": "constant", "force": 90.0}), 4) == 0.0


def test_the_time_of_a_call_is_measured() -> None:
    assert 1e-6 < call_time(controller("lqr"), Scenario(), 20) < 0.1


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(np.array([[True, True, True, True, False]]), np.array([error]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])
