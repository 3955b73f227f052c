"""The hyperparameter files for RL Baselines3 Zoo are valid for Stable-Baselines3 and the environments."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import yaml
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from torch import nn

from quadpend_train.policies.sb3_models import algorithm_class
from tests.helpers.envs import IDS
from tests.helpers.sources import ROOT

FILES = sorted((ROOT / "train/quadpend_train/rl_zoo").glob("*.yml"))
ZOO = {"n_timesteps", "n_envs", "normalize"}  # keys that the Zoo removes before it makes the model


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
@pytest.mark.parametrize("name", IDS)
def test_models_can_be_made_and_trained(path: Path, name: str) -> None:
    text = path.read_text(encoding="utf-8")
    entry: dict[str, Any] = yaml.safe_load(text)[name]
    assert f"--conf-file {path.relative_to(ROOT)}" in text
    assert isinstance(entry["n_timesteps"], int)  # YAML reads 5e6 as a string
    given = {key: value for key, value in entry.items() if key not in ZOO}
    given |= {"learning_rate": float(entry["learning_rate"].removeprefix("lin_"))}
    given |= {"policy_kwargs": eval(entry["policy_kwargs"], {"nn": nn})}  # as the Zoo does
    env: Any = DummyVecEnv([lambda: Monitor(gym.make(name))] * entry["n_envs"])
    if entry["normalize"]:
        env = VecNormalize(env, gamma=entry["gamma"], **eval(entry["normalize"]))
    model = algorithm_class(path.stem)(env=env, seed=0, device="cpu", **given)
    assert model.learn(1).num_timesteps == entry["n_envs"] * entry.get("n_steps", 1)
