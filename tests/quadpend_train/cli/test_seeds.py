"""`quadpend train --seeds` gives the policies of single trainings, and continues interrupted ones."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import train as training
from quadpend_train.training.settings import to_mapping
from quadpend_train.training.train import POLICY
from tests.helpers.training import BRIEF, interrupt_at


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    Path("brief.json").write_text(json.dumps(to_mapping(BRIEF)), encoding="utf-8")
    return ["train", "--settings", "brief.json", "--save-freq", "512"]


def weights(path: Path) -> list[Any]:
    return [array.tobytes() for layer in MlpPolicy.load(path).layers for array in layer]


@pytest.mark.parametrize("options", [[], ["--jobs", "2"]], ids=["one process", "two processes"])
def test_each_seed_gives_the_policy_of_its_training(
    options: list[str], settings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([*settings, "--seeds", "0,3", "--out", "runs/mine", *options])
    printed = capsys.readouterr().out
    assert "runs/mine-0: a new run" in printed
    assert "quadpend evaluate flatness mine=runs/mine-0,runs/mine-3" in printed
    single = training.train(replace(BRIEF, seed=3, save_freq=512), tmp_path / "single", progress=False)
    assert weights(Path("runs/mine-3", POLICY)) == weights(single)
    assert weights(Path("runs/mine-0", POLICY)) != weights(single)
    main([*settings, "--seeds", "0,3", "--out", "runs/mine"])
    assert "runs/mine-3: finished, skipped" in capsys.readouterr().out


def test_an_interrupted_seed_continues(
    settings: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one = replace(BRIEF, seed=1, save_freq=512)
    with monkeypatch.context() as patch:
        interrupt_at(1024, patch)
        with pytest.raises(KeyboardInterrupt):
            training.train(one, tmp_path / "mine-1", progress=False)
    with pytest.raises(SystemExit):
        main([*settings, "--seeds", "0-1", "--out", "mine"])
    assert "mine-1 contains an interrupted run: give --resume instead of --out" in capsys.readouterr().err
    main(["train", "--resume", "mine", "--seeds", "0-1"])
    assert "mine-1: interrupted, continues from its last checkpoint" in capsys.readouterr().out
    assert MlpPolicy.load(Path("mine-1", POLICY)).card["steps"] == BRIEF.total_timesteps
