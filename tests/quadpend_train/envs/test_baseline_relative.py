"""`BaselineRelativeReward` subtracts the reward of a controller in the same episodes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import Policy, controller
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import HybridSettings
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.training import BRIEF

ZERO_ACTIONS = np.zeros((16, 4), np.float32)
HYBRID = HybridSettings("flatness", baseline_relative_reward=True)
SETTINGS = replace(BRIEF, hybrid=HYBRID, max_episode_steps=15, reward_scale=1.0)
OPTIONS: dict[str, Any] = {"wind": "windy", "autoreset_mode": "SameStep"}
GAMMA, PENALTY = 0.9, 2.0


@pytest.mark.parametrize("scenario", ["training", "turbulence"])
def test_base_controller_alone_has_exactly_zero_reward(scenario: str) -> None:
    """In every episode: the copy has the same start, reference, wind, noise and parameters."""
    hybrid = replace(HYBRID, mode="residual_action")
    env = make_env(replace(SETTINGS, scenarios=(scenario,), hybrid=hybrid))
    env.seed(7)
    env.reset()
    ends = 0
    for _ in range(50):
        _, reward, ended, _ = env.step(ZERO_ACTIONS)
        assert_array_equal(reward, 0.0)
        ends += ended.sum()
    assert ends >= 3 * 16


class NoThrust(Policy):
    """A policy that falls."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, None]:
        return np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (len(observation), 1)), None


def make_relative(policy: Policy) -> BaselineRelativeReward:
    envs = [make_vec(3, **OPTIONS) for _ in range(2)]
    return BaselineRelativeReward(*envs, [policy], GAMMA, PENALTY)


def test_reward_is_the_difference_from_that_of_the_controller_and_a_fall_costs_what_it_would_still_earn() -> None:
    policy: Any = controller("flatness")
    env, learner, baseline = make_relative(policy), make_vec(3, **OPTIONS), make_vec(3, **OPTIONS)
    assert_array_equal(env.reset(seed=3)[0], learner.reset(seed=3)[0])
    observation, memory, steps, terminated = baseline.reset(seed=3)[0], None, 0, np.zeros(3, np.bool_)
    while not terminated.any():
        action, _ = NoThrust().predict(observation)
        _, relative, terminated, _, info = env.step(action)
        _, reward, *_, expected_info = learner.step(action)
        baseline_action, memory = policy.predict(observation, memory)
        observation, baseline_reward, *_ = baseline.step(baseline_action)
        assert_same(info, expected_info)
        cost = baseline_reward * GAMMA / (1.0 - GAMMA) + PENALTY
        assert_allclose(relative, reward - baseline_reward - terminated * cost, rtol=1e-9, atol=1e-12)
        steps += 1
    assert steps > 10


def test_fall_of_the_controller_alone_is_rewarded_and_a_fall_of_both_is_neutral() -> None:
    env, policy, memory = make_relative(NoThrust()), controller("flatness"), None
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
