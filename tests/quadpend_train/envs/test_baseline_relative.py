"""Rewards beside a controller's in the same episodes, and actions that are held."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_train.envs.action_repeat import ActionRepeat
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.training.environment import make_env
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, draw_actions, make_vec
from tests.helpers.training import BRIEF
from tests.helpers.wrappers import SHORT

IDLE = np.zeros((16, 4), np.float32)
SETTINGS = replace(BRIEF, companion="flatness", paired=True, max_episode_steps=15, reward_scale=1.0)
CALM: dict[str, Any] = {"wind": "windy", "autoreset_mode": "SameStep"}


@pytest.mark.parametrize("hold", [1, 5])
@pytest.mark.parametrize("steers", ["action", "pace"])
@pytest.mark.parametrize("scenario", ["training", "turbulence"])
def test_who_leaves_the_companion_alone_earns_nothing(scenario: str, steers: Any, hold: int) -> None:
    """Exactly, in episode after episode: the twin meets the same start, reference, wind, noise and plant."""
    env = make_env(replace(SETTINGS, scenario=(scenario,), steers=steers, hold=hold))
    env.seed(7)
    env.reset()
    ends = 0
    for _ in range(50 // hold):
        _, reward, ended, _ = env.step(IDLE)
        assert_array_equal(reward, 0.0)
        ends += ended.sum()
    assert ends >= 3 * 16


def paired(rows: int, **more: Any) -> BaselineRelativeReward:
    envs = [make_vec(rows, **CALM, **more) for _ in range(2)]
    return BaselineRelativeReward(*envs, controller("flatness"), 0.9, 2.0)


def test_a_reward_is_the_difference_from_the_controllers() -> None:
    env, learner, teacher, policy = paired(4), make_vec(4, **CALM), make_vec(4, **CALM), controller("flatness")
    assert_array_equal(env.reset(seed=3)[0], learner.reset(seed=3)[0])
    observation, memory = teacher.reset(seed=3)[0], None
    for action in 0.05 * draw_actions(0, 15, 4):
        seen, paid, terminated, truncated, info = env.step(action)
        expected, earned, *_, their_info = learner.step(action)
        bare, memory = policy.predict(observation, memory)
        observation, beside, *_ = teacher.step(bare)
        assert not (terminated | truncated).any()
        assert_array_equal(seen, expected)
        assert_same(info, their_info)
        assert_allclose(paid, earned - beside, atol=1e-12)


def test_a_fall_costs_what_the_controller_would_have_earned_from_there() -> None:
    env, learner, teacher, policy = paired(3), make_vec(3, **CALM), make_vec(3, **CALM), controller("flatness")
    env.reset(seed=3), learner.reset(seed=3)
    observation, memory = teacher.reset(seed=3)[0], None
    terminated = np.zeros(3, np.bool_)
    falling = np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (3, 1))
    while not terminated.any():
        _, paid, terminated, _, _ = env.step(falling)
        earned = learner.step(falling)[1]
        bare, memory = policy.predict(observation, memory)
        observation, beside, *_ = teacher.step(bare)
    lost = beside * 0.9 / (1.0 - 0.9) + 2.0
    assert_allclose(paid, earned - beside - terminated * lost, rtol=1e-9)


class Falling:
    """No thrust."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, None]:
        return np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (len(observation), 1)), None


def test_where_only_the_twin_falls_its_fall_is_gained_and_where_both_fall_nothing_is() -> None:
    envs = [make_vec(3, **CALM) for _ in range(2)]
    env, policy, memory = BaselineRelativeReward(*envs, Falling(), 0.9, 2.0), controller("flatness"), None
    observation, gained = env.reset(seed=3)[0], np.zeros(3)
    for _ in range(100):
        action, memory = policy.predict(observation, memory)
        observation, paid, *_ = env.step(action)
        gained = np.maximum(gained, paid)
    assert ((gained > 2.0) & (gained < 3.0)).all()
    assert ((paid > 0.5) & (paid <= 1.0)).all()
    env.reset(seed=3)
    terminated = np.zeros(3, np.bool_)
    while not terminated.any():
        _, paid, terminated, *_ = env.step(Falling().predict(observation)[0])
        assert_array_equal(paid, 0.0)


def test_a_paired_environment_takes_no_options() -> None:
    assert_refused(lambda: paired(2).reset(options={"state": {}}), "takes no options", ValueError)


def test_a_held_action_is_taken_again_and_again_and_its_rewards_add_up() -> None:
    """A row that begins anew waits, without action, until the others decide again."""
    held, plain = (make_vec(5, **CALM, **SHORT) for _ in range(2))
    env = ActionRepeat(held, 4)
    assert_array_equal(env.reset(seed=1)[0], plain.reset(seed=1)[0])
    ends = 0
    for action in 0.3 * draw_actions(0, 15, 5):
        observation, reward, terminated, truncated, info = env.step(action)
        going, earned, last = np.ones(5, np.bool_), np.zeros(5), [None] * 5
        ended = np.zeros((2, 5), np.bool_)
        for _ in range(4):
            expected, more, fell, ran_out, their_info = plain.step(np.where(going[:, np.newaxis], action, 0.0))
            earned += going * more
            for row in np.flatnonzero(going & (fell | ran_out)):
                last[row], ended[:, row] = their_info["final_obs"][row], (fell[row], ran_out[row])
                going[row] = False
        assert_array_equal(observation, expected)
        assert_array_equal(reward, earned)
        assert_array_equal([terminated, truncated], ended)
        for row in np.flatnonzero(terminated | truncated):
            assert_array_equal(info["final_obs"][row], last[row])
        ends += (terminated | truncated).sum()
    assert ends >= 8
