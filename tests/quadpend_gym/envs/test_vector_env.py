"""The vector environment: masked resets and seeds. `test_wrappers` compares its rows with single environments."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_gym.core.arrays import Floats32
from tests.helpers.envs import (
    WINDY,
    draw_actions,
    make,
    make_vec,
    run_actions,
)


def test_reset_mask_resets_only_the_masked_sub_environments() -> None:
    env, untouched = make_vec(4, wind=WINDY), make_vec(4, wind=WINDY)
    mask = np.array([True, False, False, True])
    env.reset(seed=0), untouched.reset(seed=0)
    run_actions(env, draw_actions(0, 5, 4)), run_actions(untouched, draw_actions(0, 5, 4))
    before = env.state.array.copy()
    _, info = env.reset(seed=70, options={"reset_mask": mask, "state": {"position": (0.0, 0.0, 3.0)}})
    assert_array_equal(env.state.array[~mask], before[~mask])
    assert_array_equal(env.state.position[mask], np.broadcast_to((0.0, 0.0, 3.0), (2, 3)))
    assert_array_equal(info["_tilt"], mask)
    assert env.world.episode.tolist() == [0, 0, 0, 0]
    actions = draw_actions(1, 10, 4)
    assert_array_equal(
        [step[0][~mask] for step in run_actions(env, actions)],
        [step[0][~mask] for step in run_actions(untouched, actions)],
    )
    assert_array_equal(env.reset()[0][mask], make_twice_reset(70)[mask])


def make_twice_reset(seed: int) -> Floats32:
    """Return the first observations of the second episodes of four sub-environments."""
    env = make_vec(4, wind=WINDY)
    env.reset(seed=seed)
    return env.reset()[0]


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
