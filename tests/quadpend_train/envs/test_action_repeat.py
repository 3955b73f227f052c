"""`ActionRepeat` applies an action several times and adds the rewards."""

import numpy as np
from numpy.testing import assert_array_equal

from quadpend_train.envs.action_repeat import ActionRepeat
from tests.helpers.envs import draw_actions, make_vec
from tests.helpers.wrappers import SHORT


def test_action_is_repeated_and_rewards_are_summed() -> None:
    """A sub-environment that resets receives zero actions until the repeats are over."""
    inner, reference = (make_vec(5, wind="windy", autoreset_mode="SameStep", **SHORT) for _ in range(2))
    env = ActionRepeat(inner, 4)
    assert_array_equal(env.reset(seed=1)[0], reference.reset(seed=1)[0])
    ends = 0
    for action in 0.3 * draw_actions(0, 15, 5):
        observation, reward, terminated, truncated, info = env.step(action)
        running, reward_sum, last = np.ones(5, np.bool_), np.zeros(5), [None] * 5
        ended = np.zeros((2, 5), np.bool_)
        for _ in range(4):
            repeated = np.where(running[:, np.newaxis], action, 0.0)
            expected, one_reward, one_terminated, one_truncated, one_info = reference.step(repeated)
            reward_sum += running * one_reward
            for row in np.flatnonzero(running & (one_terminated | one_truncated)):
                last[row] = one_info["final_obs"][row]
                ended[:, row] = one_terminated[row], one_truncated[row]
                running[row] = False
        assert_array_equal(observation, expected)
        assert_array_equal(reward, reward_sum)
        assert_array_equal([terminated, truncated], ended)
        for row in np.flatnonzero(terminated | truncated):
            assert_array_equal(info["final_obs"][row], last[row])
        ends += (terminated | truncated).sum()
    assert ends >= 8
