"""`BaselineRelativeReward` subtracts the reward of a controller in the same episodes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import HybridSettings
from tests.helpers.envs import assert_same, draw_actions, make_vec
from tests.helpers.training import BRIEF

ZERO_ACTIONS = np.zeros((16, 4), np.float32)
HYBRID = HybridSettings("flatness", baseline_relative_reward=True)
SETTINGS = replace(BRIEF, hybrid=HYBRID, max_episode_steps=15, reward_scale=1.0)
OPTIONS: dict[str, Any] = {"wind": "windy", "autoreset_mode": "SameStep"}
GAMMA, PENALTY = 0.9, 2.0


@pytest.mark.parametrize(
    ("scenario", "mode", "action_repeat"),
    [("training", "residual_action", 5), ("turbulence", "bandwidth_scheduling", 1)],
)
def test_base_controller_alone_has_exactly_zero_reward(scenario: str, mode: Any, action_repeat: int) -> None:
    """In every episode: the copy has the same start, reference, wind, noise and parameters."""
    hybrid = replace(HYBRID, mode=mode, action_repeat=action_repeat)
    env = make_env(replace(SETTINGS, scenarios=(scenario,), hybrid=hybrid))
    env.seed(7)
    env.reset()
    ends = 0
    for _ in range(50 // action_repeat):
        _, reward, ended, _ = env.step(ZERO_ACTIONS)
        assert_array_equal(reward, 0.0)
        ends += ended.sum()
    assert ends >= 3 * 16


def make_relative(num_envs: int) -> BaselineRelativeReward:
    envs = [make_vec(num_envs, **OPTIONS) for _ in range(2)]
    return BaselineRelativeReward(*envs, [controller("flatness")], GAMMA, PENALTY)


def test_reward_is_the_difference_from_the_reward_of_the_controller() -> None:
    env, learner, baseline = make_relative(4), make_vec(4, **OPTIONS), make_vec(4, **OPTIONS)
    policy = controller("flatness")
    assert_array_equal(env.reset(seed=3)[0], learner.reset(seed=3)[0])
    observation, memory = baseline.reset(seed=3)[0], None
    for action in 0.05 * draw_actions(0, 15, 4):
        observed, relative, terminated, truncated, info = env.step(action)
        expected, reward, *_, expected_info = learner.step(action)
        baseline_action, memory = policy.predict(observation, memory)
        observation, baseline_reward, *_ = baseline.step(baseline_action)
        assert not (terminated | truncated).any()
        assert_array_equal(observed, expected)
        assert_same(info, expected_info)
        assert_allclose(relative, reward - baseline_reward, atol=1e-12)


def test_fall_costs_the_discounted_rewards_that_the_controller_would_still_earn() -> None:
    env, learner, baseline = make_relative(3), make_vec(3, **OPTIONS), make_vec(3, **OPTIONS)
    policy = controller("flatness")
    env.reset(seed=3), learner.reset(seed=3)
    observation, memory = baseline.reset(seed=3)[0], None
    terminated = np.zeros(3, np.bool_)
    no_thrust = np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (3, 1))
    while not terminated.any():
        _, relative, terminated, _, _ = env.step(no_thrust)
        reward = learner.step(no_thrust)[1]
        baseline_action, memory = policy.predict(observation, memory)
        observation, baseline_reward, *_ = baseline.step(baseline_action)
    cost = baseline_reward * GAMMA / (1.0 - GAMMA) + PENALTY
    assert_allclose(relative, reward - baseline_reward - terminated * cost, rtol=1e-9)


class NoThrust:
    """A policy that falls."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, None]:
        return np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (len(observation), 1)), None


def test_fall_of_the_controller_alone_is_rewarded_and_a_fall_of_both_is_neutral() -> None:
    envs = [make_vec(3, **OPTIONS) for _ in range(2)]
    env, policy, memory = BaselineRelativeReward(*envs, [NoThrust()], GAMMA, PENALTY), controller("flatness"), None
    observation, largest = env.reset(seed=3)[0], np.zeros(3)
    for _ in range(100):
        action, memory = policy.predict(observation, memory)
        observation, relative, *_ = env.step(action)
        largest = np.maximum(largest, relative)
    assert ((largest > 2.0) & (largest < 3.0)).all()
    assert ((relative > 0.5) & (relative <= 1.0)).all()
    env.reset(seed=3)
    terminated = np.zeros(3, np.bool_)
    while not terminated.any():
        _, relative, terminated, *_ = env.step(NoThrust().predict(observation)[0])
        assert_array_equal(relative, 0.0)
