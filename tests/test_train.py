"""Training runs, is interrupted and goes on, keeps its origin, and can be repeated."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import PPO

from train import train as training
from train.flights import TEST_SEED, VALIDATION_SEED
from train.settings import TrainSettings, read_settings

BRIEF = TrainSettings(total_steps=2048, num_envs=16, rollout_steps=32, batch_size=256, epochs=1)


def weights(path: Path) -> np.ndarray:
    parameters = PPO.load(path, device="cpu").policy.parameters()
    return np.concatenate([parameter.detach().numpy().ravel() for parameter in parameters])


def test_a_run_folder_holds_all_that_the_run_is(tmp_path: Path) -> None:
    model = training.train(BRIEF, tmp_path, progress=False)
    assert PPO.load(model, device="cpu").num_timesteps == BRIEF.total_steps
    assert TrainSettings(**json.loads((tmp_path / "settings.json").read_text())) == BRIEF
    origin = json.loads((tmp_path / "origin.json").read_text())
    assert {"command", "commit", "python", "packages"} <= set(origin)
    assert list(tmp_path.glob("events*/events.out.tfevents*"))


def test_the_same_settings_give_the_same_weights(tmp_path: Path) -> None:
    first, second = (training.train(BRIEF, tmp_path / name, progress=False) for name in "ab")
    np.testing.assert_array_equal(weights(first), weights(second))


def test_an_interrupted_run_goes_on_from_its_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learn = PPO.train

    def interrupted(model: PPO) -> None:
        learn(model)
        if model.num_timesteps >= BRIEF.total_steps // 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(PPO, "train", interrupted)
        with pytest.raises(KeyboardInterrupt):
            training.train(BRIEF, tmp_path, progress=False)
    assert PPO.load(tmp_path / "checkpoint.zip", device="cpu").num_timesteps == BRIEF.total_steps // 2
    model = training.resume(tmp_path, progress=False)
    assert PPO.load(model, device="cpu").num_timesteps == BRIEF.total_steps
    with pytest.raises(FileNotFoundError, match="is finished"):
        training.resume(tmp_path)


def test_checkpoints_are_kept_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []
    monkeypatch.setattr(training, "save_checkpoint", lambda model, folder: kept.append(model.num_timesteps))
    settings = TrainSettings(**{**BRIEF.__dict__, "checkpoint_steps": 1024})
    training.train(settings, tmp_path, progress=False)
    assert kept == [1024]


def test_training_ends_when_its_time_is_up(tmp_path: Path) -> None:
    settings = TrainSettings(**{**BRIEF.__dict__, "total_steps": 10**9, "max_seconds": 1.0})
    assert PPO.load(training.train(settings, tmp_path, progress=False), device="cpu").num_timesteps < 10**7


def test_a_folder_with_a_run_is_not_overwritten(tmp_path: Path) -> None:
    training.train(BRIEF, tmp_path, progress=False)
    with pytest.raises(FileExistsError, match="holds a run already"):
        training.train(BRIEF, tmp_path, progress=False)
    with pytest.raises(FileNotFoundError, match="holds no run"):
        training.resume(tmp_path / "nowhere")


def test_a_run_that_died_before_its_first_checkpoint_begins_again(tmp_path: Path) -> None:
    finished = training.train(BRIEF, tmp_path / "whole", progress=False)
    dead = tmp_path / "dead"
    dead.mkdir()
    (dead / "settings.json").write_text((tmp_path / "whole/settings.json").read_text())
    np.testing.assert_array_equal(weights(training.resume(dead, progress=False)), weights(finished))


def test_no_two_runs_and_no_evaluation_share_an_episode() -> None:
    blocks = [training.first_episode(TrainSettings(seed=seed)) for seed in range(3)]
    rows = 2**31  # more than rows and steps of any run
    assert all(after - before > rows for before, after in pairwise(blocks))
    assert blocks[0] > max(TEST_SEED, VALIDATION_SEED) + rows


def test_a_fresh_run_begins_with_the_episodes_of_its_block() -> None:
    model = training._fresh_model(BRIEF, Path("unused"))
    assert model.env is not None
    expected = training.make_env(BRIEF)
    expected.seed(training.first_episode(BRIEF))
    np.testing.assert_array_equal(model.env.reset(), expected.reset())


def test_a_run_is_repeated_from_its_folder(tmp_path: Path) -> None:
    training.train(BRIEF, tmp_path, progress=False)
    assert read_settings(str(tmp_path / "settings.json")) == BRIEF


def test_settings_files_are_deltas_and_mistakes_in_them_are_named(tmp_path: Path) -> None:
    assert read_settings("demo").scenario == "windy"
    path = tmp_path / "mine.toml"
    path.write_text("seed = 7\nhidden = [32]\n")
    assert read_settings(str(path)) == TrainSettings(seed=7, hidden=(32,))
    path.write_text("sead = 7\n")
    with pytest.raises(ValueError, match="sets 'sead', which is no setting"):
        read_settings(str(path))
    with pytest.raises(ValueError, match="no settings 'nix'"):
        read_settings("nix")
    with pytest.raises(ValueError, match="no scenario 'nix'"):
        TrainSettings(scenario="nix")


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"epochs": 0}, "epochs must be a whole number of at least 1, not 0"),
        ({"num_envs": 1.5}, "num_envs must be a whole number of at least 1, not 1.5"),
        ({"seed": -1}, "seed must be a whole number of at least 0, not -1"),
        ({"hidden": (0,)}, r"hidden\[0\] must be a whole number"),
        ({"discount": 5.0}, r"discount must be a finite number in \[0, 1\], not 5.0"),
        ({"max_seconds": -3.0}, "max_seconds must be a finite number"),
        ({"learning_rate": 0.0}, "learning_rate must be above zero"),
        ({"activation": "foo"}, "activation must be one of relu, tanh, elu, not 'foo'"),
        ({"batch_size": 1000}, "batch_size must divide num_envs"),
    ],
)
def test_settings_out_of_range_are_refused(setting: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TrainSettings(**setting)
