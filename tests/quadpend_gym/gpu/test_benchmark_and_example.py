"""The benchmark and the example of docs/gpu.md run in numba's CUDA simulator."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from numba import cuda

from tests.helpers.sources import ROOT

SIMULATOR = {"NUMBA_ENABLE_CUDASIM": "1"}


def run(folder: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths, **variables}
    command = [sys.executable, "-W", "ignore", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.skipif(find_spec("numba_cuda") is not None and cuda.is_available(), reason="there is an NVIDIA GPU")
def test_without_a_gpu_the_benchmark_says_so_and_measures_nothing(tmp_path: Path) -> None:
    ran = run(tmp_path, "-m", "benchmarks.gpu", "--out", "gpu.json")
    assert ran.returncode == 1
    assert ran.stderr.startswith("nothing was measured: ")
    assert len(ran.stderr.splitlines()) == 1
    assert not (tmp_path / "gpu.json").exists()


def test_the_benchmark_measures_every_number_of_sub_environments(tmp_path: Path) -> None:
    brief = "--num-envs", "1", "3", "--seconds", "0.001", "--out", "gpu.json"
    ran = run(tmp_path, "-m", "benchmarks.gpu", *brief, **SIMULATOR)
    assert ran.returncode == 0, ran.stderr
    assert "say nothing about a GPU" in ran.stdout
    rates = json.loads((tmp_path / "gpu.json").read_text())["steps_per_second"]
    assert list(rates) == ["1", "3"]
    assert all(value > 0.0 for rate in rates.values() for value in rate.values())


@pytest.mark.skipif(find_spec("rsl_rl") is None, reason="needs rsl-rl: pip install 'quadpend-gym[rsl]'")
def test_rsl_rl_trains_on_the_environment(tmp_path: Path) -> None:
    script, brief = str(ROOT / "docs/examples/ppo_on_gpu.py"), ("--num-envs", "3", "--iterations", "1", "--steps", "4")
    ran = run(tmp_path, script, *brief, **SIMULATOR)
    assert ran.returncode == 0, ran.stderr
    assert "Learning iteration 0/1" in ran.stdout
    assert list((tmp_path / "runs/ppo-on-gpu").glob("model_*.pt"))
