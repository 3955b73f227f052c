"""The scripts in `train/` and `docs/examples/` run without changes, with fewer steps."""

import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

Run = Callable[..., str]


@pytest.fixture
def run_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a script with arguments as `python` does, but in this process, and return what it prints."""
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(ROOT / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_ppo_script_trains_saves_and_evaluates_a_model(run_script: Run, tmp_path: Path) -> None:
    assert "mean return" in run_script("train/ppo.py", "--total-timesteps", "2000")
    assert (tmp_path / "ppo.zip").is_file()


def test_the_script_for_a_gpu_trains_on_the_processor(run_script: Run, tmp_path: Path) -> None:
    arguments = "--device", "c", "--num-envs", "32", "--num-steps", "16", "--minibatches", "2", "--seconds", "1"
    assert "survival" in run_script("train/ppo_gpu.py", *arguments)
    assert (tmp_path / "ppo_gpu.pt").is_file()


def test_the_loop_in_the_manner_of_cleanrl_trains(run_script: Run) -> None:
    assert "update 0: mean length of an episode" in run_script("docs/examples/ppo_as_in_cleanrl.py", "--updates", "1")


def test_a_script_runs_as_train_py_beside_folders_with_the_names_of_our_packages(tmp_path: Path) -> None:
    for package in ("baselines", "benchmarks", "tests"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    script = (ROOT / "train/ppo.py").read_text(encoding="utf-8")
    assert "default=3_000_000" in script
    (tmp_path / "train.py").write_text(script.replace("default=3_000_000", "default=64"), encoding="utf-8")
    ran = subprocess.run([sys.executable, "train.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
