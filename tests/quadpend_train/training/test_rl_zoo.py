"""The hyperparameter files for RL Baselines3 Zoo are valid for Stable-Baselines3 and the environments."""

import inspect
import shlex
from typing import Any

import gymnasium as gym
import pytest
import yaml
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from torch import nn

from quadpend_train.policies.sb3_models import algorithm_class
from quadpend_train.training.settings import SB3_ALGORITHMS
from tests.helpers.envs import IDS
from tests.helpers.sources import ROOT

FOLDER = ROOT / "train/quadpend_train/rl_zoo"
ZOO = {"n_timesteps", "n_envs", "normalize"}  # keys that the Zoo removes before it makes the model
algorithms = pytest.mark.parametrize("algo", SB3_ALGORITHMS)


def read(algo: str) -> dict[str, dict[str, Any]]:
    """Return the entries for an algorithm by environment id."""
    entries = yaml.safe_load((FOLDER / f"{algo}.yml").read_text(encoding="utf-8"))
    assert isinstance(entries, dict)
    return entries


def python(text: str) -> Any:
    """Evaluate Python code in a string as the Zoo does."""
    return eval(text, {"nn": nn})


def make_model(algo: str, name: str, entry: dict[str, Any]) -> Any:
    """Return the model that the Zoo would make, with a constant learning rate."""
    entry = dict(entry)
    entry["policy_kwargs"] = python(entry["policy_kwargs"])
    schedule, rate = entry["learning_rate"].split("_")
    assert schedule == "lin"
    env: Any = DummyVecEnv([lambda: Monitor(gym.make(name))] * entry["n_envs"])
    if entry["normalize"]:
        env = VecNormalize(env, gamma=entry["gamma"], **python(entry["normalize"]))
    given = {key: value for key, value in entry.items() if key not in ZOO} | {"learning_rate": float(rate)}
    return algorithm_class(algo)(env=env, seed=0, device="cpu", **given)


def test_there_is_a_file_for_every_algorithm() -> None:
    assert {path.stem for path in FOLDER.glob("*.yml")} == set(SB3_ALGORITHMS)


@algorithms
def test_every_environment_id_has_an_entry(algo: str) -> None:
    assert set(read(algo)) == set(IDS)


@algorithms
def test_every_key_is_an_argument_of_the_algorithm_or_of_the_zoo(algo: str) -> None:
    known = ZOO | set(inspect.signature(algorithm_class(algo)).parameters)
    for entry in read(algo).values():
        assert set(entry) <= known


@algorithms
@pytest.mark.parametrize("name", IDS)
def test_models_can_be_made_and_trained(algo: str, name: str) -> None:
    entry = read(algo)[name]
    assert isinstance(entry["n_timesteps"], int)  # YAML reads 5e6 as a string
    model = make_model(algo, name, entry)
    assert model.learn(1).num_timesteps == entry["n_envs"] * entry.get("n_steps", 1)


@algorithms
def test_command_in_the_comment_uses_the_file(algo: str) -> None:
    comments = (FOLDER / f"{algo}.yml").read_text(encoding="utf-8").splitlines()
    (command,) = (line for line in comments if "rl_zoo3.train" in line)
    words = shlex.split(command.removeprefix("#"))
    given = dict(zip(words[3::2], words[4::2], strict=True))
    assert words[:3] == ["python", "-m", "rl_zoo3.train"]
    assert given["--algo"] == algo
    assert given["--env"] in IDS
    assert given["--gym-packages"] == "quadpend_gym"
    assert ROOT / given["--conf-file"] == FOLDER / f"{algo}.yml"
