"""The scripts in `train/` run without changes, with fewer steps."""

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

SCRIPTS = sorted((ROOT / "train").glob("*.py"))


Run = Callable[..., str]


@pytest.fixture
def run_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a script of `train/` with arguments as `python` does, but in this process, and return what it prints."""
    shorten_scenarios(monkeypatch, 1.0)

    def run(name: str, *arguments: str) -> str:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(ROOT / "train" / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_there_are_three_scripts() -> None:
    assert [path.name for path in SCRIPTS] == ["compare.py", "ppo.py", "sac.py"]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_have_30_to_60_lines_and_name_their_command_at_the_top(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert 30 <= len(text.splitlines()) <= 60
    assert f"python train/{path.name}" in text.split('"""')[1]


def test_ppo_script_trains_saves_and_evaluates_a_model_that_compare_script_compares(
    run_script: Run, tmp_path: Path
) -> None:
    assert "mean return" in run_script("ppo.py", "--total-timesteps", "2000")
    table = run_script("compare.py", "ppo.zip", "--episodes", "2").splitlines()
    assert [line.split()[:2] for line in table[1:]] == [
        [scenario, name] for scenario in ("windy", "gusts") for name in ("ppo", "flatness", "adrc-paper")
    ]
    assert (tmp_path / "ppo.npz").is_file()


def test_sac_script_trains_saves_and_evaluates_a_model(run_script: Run, tmp_path: Path) -> None:
    assert "Mean return" in run_script("sac.py", "--total-timesteps", "2000")
    assert (tmp_path / "sac.zip").is_file()
