"""The scripts in `train/` run without changes, with fewer steps."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.sources import ROOT

SCRIPTS = sorted((ROOT / "train").glob("*.py"))


def run_script(name: str, folder: Path, *arguments: str) -> str:
    """Run a script of `train/` in `folder` and return what it prints."""
    command = [sys.executable, str(ROOT / "train" / name), *arguments]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_there_are_three_scripts() -> None:
    assert [path.name for path in SCRIPTS] == ["compare.py", "ppo.py", "sac.py"]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_have_30_to_60_lines_and_name_their_command_at_the_top(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert 30 <= len(text.splitlines()) <= 60
    assert f"python train/{path.name}" in text.split('"""')[1]


def test_ppo_script_trains_saves_and_evaluates_a_model_that_compare_script_compares(tmp_path: Path) -> None:
    assert "mean return" in run_script("ppo.py", tmp_path, "--total-timesteps", "2000")
    table = run_script("compare.py", tmp_path, "ppo.zip", "--episodes", "2").splitlines()
    assert [line.split()[:2] for line in table[1:]] == [
        [scenario, name] for scenario in ("windy", "gusts") for name in ("ppo", "flatness", "adrc-paper")
    ]
    assert (tmp_path / "ppo.npz").is_file()


def test_sac_script_trains_saves_and_evaluates_a_model(tmp_path: Path) -> None:
    assert "Mean return" in run_script("sac.py", tmp_path, "--total-timesteps", "2000")
    assert (tmp_path / "sac.zip").is_file()
