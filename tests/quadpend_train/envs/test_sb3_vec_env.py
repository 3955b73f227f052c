"""`SB3VecEnv` behaves like the vector environments of Stable-Baselines3."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor

from quadpend_gym import OrnsteinUhlenbeck, QuadPendulumVectorEnv
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv

NUM_ENVS, STEPS = 3, 150


def make_monitored() -> gym.Env[Any, Any]:
    return Monitor(gym.make("quadpend_gym:QuadPendulum-v0", wind=OrnsteinUhlenbeck(), max_episode_steps=60))


def test_steps_equal_those_of_dummy_vec_env_with_monitors() -> None:
    """Observations, rewards, dones, terminal observations, truncation and episode statistics."""
    reference = DummyVecEnv([make_monitored] * NUM_ENVS)
    env = SB3VecEnv(
        QuadPendulumVectorEnv(
            NUM_ENVS, wind=OrnsteinUhlenbeck(), max_episode_steps=60, autoreset_mode=AutoresetMode.SAME_STEP
        )
    )
    reference.seed(5), env.seed(5)
    np.testing.assert_array_equal(reference.reset(), env.reset())
    actions = np.random.default_rng(0).normal(scale=0.03, size=(STEPS, NUM_ENVS, 4)).clip(-1, 1).astype(np.float32)
    ended = 0
    for action in actions:
        expected, given = reference.step(action), env.step(action)
        for a, b in zip(expected[:3], given[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        for row in np.flatnonzero(given[2]):
            info, other = expected[3][row], given[3][row]
            np.testing.assert_array_equal(info["terminal_observation"], other["terminal_observation"])
            assert info["TimeLimit.truncated"] == other["TimeLimit.truncated"]
            assert info["episode"]["l"] == other["episode"]["l"]
            assert info["episode"]["r"] == pytest.approx(other["episode"]["r"], abs=1e-5)
            ended += 1
    assert ended > NUM_ENVS


def test_reward_scale_does_not_change_episode_statistics() -> None:
    plain, scaled = (
        SB3VecEnv(QuadPendulumVectorEnv(2, max_episode_steps=3, autoreset_mode="SameStep"), scale)
        for scale in (1.0, 0.01)
    )
    plain.seed(0), scaled.seed(0)
    plain.reset(), scaled.reset()
    for _ in range(3):
        expected, given = plain.step(np.zeros((2, 4), np.float32)), scaled.step(np.zeros((2, 4), np.float32))
        np.testing.assert_allclose(given[1], 0.01 * expected[1], rtol=1e-6)
    assert given[3][0]["episode"]["r"] == expected[3][0]["episode"]["r"]


ROWS: list[dict[str, Any]] = [{"state": {"position": (1.0, 0.0, 2.0)}}, {}, {"state": {"euler": (0.1, 0.0, 0.0)}}]


@pytest.mark.parametrize("rows", [ROWS, ROWS[0]], ids=["for each row", "for all"])
def test_options_and_seeds_apply_to_one_reset_as_in_dummy_vec_env(rows: Any) -> None:
    reference = DummyVecEnv([make_monitored] * NUM_ENVS)
    env = SB3VecEnv(QuadPendulumVectorEnv(NUM_ENVS, wind=OrnsteinUhlenbeck(), autoreset_mode="SameStep"))
    for wrapped in (reference, env):
        wrapped.seed(5), wrapped.set_options(rows)
    action = np.zeros((NUM_ENVS, 4), np.float32)
    for _ in range(2):  # seeds and options apply to the first reset only
        np.testing.assert_array_equal(reference.reset(), env.reset())
        np.testing.assert_array_equal(reference.step(action)[0], env.step(action)[0])
        assert [info.keys() for info in reference.reset_infos] == [info.keys() for info in env.reset_infos]
    env.set_options(ROWS[:2])
    with pytest.raises(ValueError, match="options must be one mapping or 3 mappings, not 2"):
        env.reset()


@pytest.mark.filterwarnings("ignore:The environment is already wrapped with a `Monitor`")
def test_the_info_of_an_ended_episode_is_that_of_dummy_vec_env() -> None:
    plain = DummyVecEnv([lambda: gym.make("quadpend_gym:QuadPendulum-v0", max_episode_steps=3)])
    inner = QuadPendulumVectorEnv(1, max_episode_steps=3, autoreset_mode="SameStep")
    env = VecFrameStack(VecMonitor(SB3VecEnv(inner), info_keywords=("tilt", "reward_terms")), 2)
    plain.seed(0), env.seed(0)
    plain.reset(), env.reset()
    for _ in range(3):
        expected, given = (wrapped.step(np.zeros((1, 4), np.float32))[3][0] for wrapped in (plain, env))
    assert given.keys() == {*expected, "episode"}
    assert given["reward_terms"] == expected["reward_terms"] == given["episode"]["reward_terms"]
    assert given["tilt"] == expected["tilt"] == given["episode"]["tilt"]


def test_what_has_no_value_for_one_row_is_refused_for_some_rows() -> None:
    env = SB3VecEnv(QuadPendulumVectorEnv(2, autoreset_mode="SameStep"))
    for call in (lambda: env.set_attr("mine", 1, 0), lambda: env.env_method("render", indices=[1])):
        with pytest.raises(ValueError, match="indices must be None or all"):
            call()
    with pytest.raises(IndexError):
        env.get_attr("num_envs", 2)


def test_restart_begins_new_episodes_in_some_rows_only() -> None:
    envs = [QuadPendulumVectorEnv(2, autoreset_mode="SameStep") for _ in range(2)]
    env = SB3VecEnv(ConcatenatedVectorEnv(envs))
    env.seed(3)
    env.reset()
    before, *_ = env.step(np.zeros((4, 4), np.float32))
    rows = np.array([True, False, False, True])
    after = env.restart(rows)
    np.testing.assert_array_equal(after[~rows], before[~rows])
    assert (after[rows] != before[rows]).any(axis=1).all()
    assert [*envs[0].world.clock, *envs[1].world.clock] == [0, 1, 1, 0]
