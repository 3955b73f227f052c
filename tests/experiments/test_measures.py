"""Settling times, and the time of a call."""

import numpy as np

from experiments.measures import call_time, settling_times
from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario


def test_the_time_of_a_call_is_measured() -> None:
    assert 1e-6 < call_time(controller("lqr"), Scenario(), 20) < 0.1


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(np.array([[True, True, True, True, False]]), np.array([error]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])
