"""Starts of the recovery angles, and the largest angle that is recovered."""

import numpy as np

from experiments import vehicles


def test_starts_are_those_of_a_pole_that_turns_about_its_pivot() -> None:
    state = vehicles.starts(np.array([0.0, 0.5]), np.array([2.0, 0.0]))["state"]
    np.testing.assert_allclose(np.linalg.norm(state["direction"], axis=1), 1.0)
    np.testing.assert_allclose(np.sum(state["direction_rate"] * state["direction"], axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(state["direction_rate"], axis=1), [2.0, 0.0])


def test_the_largest_recovered_value_has_no_failure_below_it() -> None:
    values = np.array([0.0, 0.1, 0.2, 0.3])
    nan = np.nan
    for times, largest in (([2, 2, nan, 2], 0.1), ([2, 2, 2, 2], 0.3), ([nan, 2, 2, 2], nan), ([2, nan, nan, 2], 0.0)):
        np.testing.assert_equal(vehicles.largest_recovered(np.array([times]), values), largest)
