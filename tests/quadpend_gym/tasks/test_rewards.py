"""The reward follows its equations, and never favours an early end."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import RewardWeights, read_observation
from tests.helpers.envs import ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec, run_actions


@pytest.mark.parametrize("tip", [0.0, 0.5, 1.0])
def test_the_terms_follow_the_equations(tip: float) -> None:
    """The default weight of the narrow peak is one half."""
    env = make_unwrapped(task=replace(ENDLESS, reward=RewardWeights() if tip == 0.5 else RewardWeights(tip=tip)))
    env.reset(seed=0)
    for action in draw_actions(0, 30):
        observation, _, _, _, info = env.step(action)
        error = np.linalg.norm(info["tracking_error"])
        yaw_error = read_observation(observation, "attitude")[2]
        expected = {
            "tracking": (1.0 - tip) / (1.0 + (error / 0.3) ** 2) + tip / (1.0 + error / 0.02),
            "upright": max(env.state.direction[2], 0.0) ** 2,
            "yaw": 1.0 / (1.0 + (yaw_error / 0.2) ** 2),
            "effort": 1.0 / (1.0 + np.sum(action.astype(np.float64) ** 2)),
        }
        assert expected.keys() == info["reward_terms"].keys()
        for name, value in expected.items():
            assert_allclose(info["reward_terms"][name], value, rtol=1e-6, err_msg=name)


def test_the_reward_is_the_weighted_mean_of_terms_in_0_to_1() -> None:
    """No term is negative, so an early end loses the rewards of the remaining steps."""
    names = ("tracking", "upright", "yaw", "effort")
    for weights in (RewardWeights(), RewardWeights(1.0, 2.0, 3.0, 4.0)):
        env = make_vec(200, wind=WINDY, task=replace(ENDLESS, reward=weights))
        env.reset(seed=0)
        for _, reward, _, _, info in run_actions(env, draw_actions(0, 50, 200)):
            terms = np.array([info["reward_terms"][name] for name in names])
            assert_allclose(reward, np.average(terms, 0, [getattr(weights, name) for name in names]), rtol=1e-12)
            assert 0.0 <= terms.min() <= terms.max() <= 1.0


def test_a_weight_of_the_action_rate_multiplies_the_reward() -> None:
    """It compares with the action of the step before, in the first step of an episode with hover."""
    found = []
    for share in (0.0, 0.3):
        env = make_vec(3, task=replace(ENDLESS, reward=RewardWeights(action_rate=share)), duration=0.1)
        env.reset(seed=0)
        actions = draw_actions(0, 10, 3)
        found.append(np.array([reward for _, reward, *_ in run_actions(env, actions)]))
    change = np.diff(actions.astype(np.float64), axis=0, prepend=0.0)
    factor = 0.7 + 0.3 / (1.0 + np.sum(change**2, axis=-1) / (10.0 * 0.01) ** 2)
    assert_allclose(found[1], factor * found[0], rtol=1e-12)
