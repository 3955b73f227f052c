"""Settling times."""

import numpy as np

from experiments.measures import settling_times


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(np.array([[True, True, True, True, False]]), np.array([error]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])
