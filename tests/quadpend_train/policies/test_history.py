"""A model that was trained with a history flies in the wrapper that gives it the history."""

from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from stable_baselines3 import PPO

from quadpend_gym.scenarios import Scenario
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.evaluation.episodes import run_episodes
from tests.helpers.envs import make_vec
from tests.helpers.own_code import write_module

CODE = """
from stable_baselines3 import PPO
from quadpend_gym.wrappers import VectorHistoryWrapper

def make():
    return PPO.load("{path}", device="cpu"), lambda env: VectorHistoryWrapper(env, 2, 2)
"""


def test_a_model_with_a_history_flies_in_its_wrapper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from quadpend_train.policies.loading import load_policy

    env = SB3VecEnv(VectorHistoryWrapper(make_vec(2, autoreset_mode="SameStep"), 2, 2))
    model = PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, n_steps=4, batch_size=8, seed=0, device="cpu")
    model.learn(8).save(path := tmp_path / "model.zip")
    policy = load_policy(f"{write_module(tmp_path, monkeypatch, CODE.format(path=path))}:make")
    scenario = Scenario(duration=0.5)
    found = run_episodes([policy], scenario, 1, seed=5)
    own = VectorHistoryWrapper(scenario.make_vec(1), 2, 2)
    observation, total = own.reset(seed=5)[0], 0.0
    for _ in range(int(found.steps[0, 0])):
        observation, reward, *_ = own.step(model.predict(observation, deterministic=True)[0])
        total += float(reward[0])
    assert_allclose(found.episode_return[0, 0], total, rtol=1e-5)
