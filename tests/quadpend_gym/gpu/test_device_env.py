"""The environment on the device flies the episodes of the CPU, in numba's CUDA simulator and on a GPU."""

import os
import subprocess
import sys
from importlib.util import find_spec
from types import SimpleNamespace

import pytest
from gymnasium.error import DependencyNotInstalled
from numba import cuda, types

from quadpend_gym.gpu import DeviceVectorEnv
from quadpend_gym.gpu.kernels import make_kernels
from tests.helpers.sources import ROOT

INSTALLED = find_spec("numba_cuda") is not None
HAS_GPU = INSTALLED and cuda.is_available()


def run_on_device(**environment: str) -> None:
    command = [sys.executable, "-W", "ignore", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "ignore"]
    file = "tests/quadpend_gym/gpu/on_device.py"
    variables = {**os.environ, **environment}
    ran = subprocess.run([*command, file], cwd=ROOT, env=variables, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout[-5000:] + ran.stderr[-2000:]


def test_the_simulator_flies_the_episodes_of_the_cpu() -> None:
    run_on_device(NUMBA_ENABLE_CUDASIM="1")


@pytest.mark.skipif(not HAS_GPU, reason="needs an NVIDIA GPU and the extra gpu")
def test_a_gpu_flies_the_episodes_of_the_cpu() -> None:
    run_on_device()


@pytest.mark.skipif(HAS_GPU, reason="there is an NVIDIA GPU")
def test_without_a_gpu_one_sentence_says_what_is_missing() -> None:
    if INSTALLED:
        with pytest.raises(RuntimeError, match="there is no CUDA device"):
            DeviceVectorEnv()
    else:
        with pytest.raises(DependencyNotInstalled, match="numba-cuda is not installed: pip install"):
            DeviceVectorEnv()


@pytest.mark.skipif(not INSTALLED, reason="needs numba-cuda: pip install 'quadpend-gym[gpu]'")
@pytest.mark.parametrize("is_rigid", [False, True], ids=["paper", "rigid"])
def test_the_step_compiles_for_a_gpu_and_stays_in_registers(is_rigid: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a GPU too: NVVM translates the kernel for compute capability 9.0."""
    capability = SimpleNamespace(compute_capability=(9, 0))
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: capability)
    float64, float32 = types.float64, types.float32
    memory, counters, keys, flat = float64[::1, :], types.int64[:, ::1], types.uint64[::1], float64[::1]
    action, rows, ended, invalid = float32[:, ::1], float32[::1, :], types.boolean[:, ::1], types.int64[::1]
    signature = memory, counters, keys, flat, flat, action, rows, rows, flat, ended, invalid
    ptx, _ = cuda.compile_ptx(make_kernels(is_rigid).step.py_func, signature, cc=(9, 0))
    assert "fma.rn.f64" in ptx
    assert "local_depot" not in ptx
    assert "call.uni" not in ptx
