"""Final observations with same-step autoreset: reading and replacing ``info["final_obs"]``."""

from typing import Any

import numpy as np
from numpy.testing import assert_array_equal

from quadpend_gym.wrappers.same_step import last_observations, replace_final_observations

OBSERVATION = np.arange(6, dtype=np.float32).reshape(3, 2)
ENDED = np.array([False, True, True])


def final_info() -> dict[str, Any]:
    """Return an info with the final observations [10, 11] and [20, 21] of sub-environments 1 and 2."""
    final = np.empty(3, object)
    final[1], final[2] = np.array([10.0, 11.0], np.float32), np.array([20.0, 21.0], np.float32)
    return {"final_obs": final, "_final_obs": ENDED}


def test_last_observations_are_final_where_an_episode_ended() -> None:
    before = OBSERVATION.copy()
    assert_array_equal(last_observations(OBSERVATION, final_info(), ENDED), [[0, 1], [10, 11], [20, 21]])
    assert_array_equal(OBSERVATION, before)


def test_without_final_observations_the_last_ones_are_those_of_the_step() -> None:
    assert last_observations(OBSERVATION, {}, ENDED) is OBSERVATION


def test_replaced_final_observations_are_copies_and_leave_the_old_array_unchanged() -> None:
    info, last = final_info(), np.full((3, 1), 7.0, np.float32)
    old = info["final_obs"]
    replace_final_observations(info, ENDED, last)
    last[:] = 0.0
    assert info["final_obs"][0] is None
    assert_array_equal(np.stack(info["final_obs"][ENDED]), [[7.0], [7.0]])
    assert_array_equal(info["_final_obs"], ENDED)
    assert_array_equal(old[1], [10.0, 11.0])
