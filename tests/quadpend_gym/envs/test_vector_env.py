"""Seeds of the vector environment. `test_wrappers` compares its rows with single environments, and resets by mask."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers.envs import make, make_vec


@pytest.mark.parametrize("seeds", [[5, 2, 5], (5, 2, 5), np.array([5, 2, 5])], ids=["list", "tuple", "array"])
def test_each_sub_environment_can_have_its_own_seed(seeds: Any) -> None:
    observation, _ = make_vec(3).reset(seed=seeds)
    assert_array_equal(observation, [make().reset(seed=seed)[0] for seed in (5, 2, 5)])


def test_a_sub_environment_without_a_seed_starts_its_next_episode() -> None:
    env, single = make_vec(3), make()
    env.reset(seed=10)
    single.reset(seed=12)
    observation, _ = env.reset(seed=[None, 11, None])
    assert_array_equal(observation[1], make().reset(seed=11)[0])
    assert_array_equal(observation[2], single.reset()[0])
