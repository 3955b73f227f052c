"""A change of a function invalidates the cache of those that inline it, and compilation changes no number.

What is wrong with the cache stops no program.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba import config, jit
from numba.core.caching import IndexDataCacheFile

from quadpend_gym.core import jit as module
from quadpend_gym.core.jit import compiled, inlined
from tests.helpers.sources import ROOT

CIRCLE = "from quadpend_gym import Reference; print(Reference.circle(1.0, 1.0).derivatives(0.0)[0, 1])"


def run(folder: Path, script: str, **variables: str) -> Any:
    """Run a script in a process of its own, which imports quadpend_gym from `folder`."""
    environment = {**os.environ, "PYTHONPATH": str(folder), **variables}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)


def output(folder: Path, script: str, **variables: str) -> str:
    return str(run(folder, script, **variables).stdout)


def _doubled(x: float) -> float:
    return 2.0 * x


_factor = 2.0


def _scaled(x: float) -> float:
    return _factor * x


def test_a_change_of_an_inlined_function_in_another_file_invalidates_the_cache(tmp_path: Path) -> None:
    """`_evaluate_reference` of `trajectories.py` inlines `sincos` of `elementary.py`, which sets the circle."""
    shutil.copytree(ROOT / "quadpend_gym", tmp_path / "quadpend_gym", ignore=shutil.ignore_patterns("__pycache__"))
    assert float(output(tmp_path, CIRCLE)) == 0.0
    edited = tmp_path / "quadpend_gym/core/elementary.py"
    edited.write_text(edited.read_text().replace("return sine, cosine", "return sine + 1.0, cosine"))
    assert float(output(tmp_path, CIRCLE)) == 1.0


STEPS = """
import numpy as np
from quadpend_gym import QuadPendulumEnv
env = QuadPendulumEnv(wind="windy")
print(env.reset(seed=0)[0].tolist(), *(env.step(np.full(4, 0.1, np.float32))[:2] for _ in range(2)))
"""


def test_without_compilation_the_numbers_are_the_same() -> None:
    assert output(ROOT, STEPS, NUMBA_DISABLE_JIT="1") == output(ROOT, STEPS)


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize(
    "damage", [lambda data: b"", lambda data: data[:-9], lambda data: b"?" * 99], ids=["empty", "cut", "garbage"]
)
def test_a_damaged_file_of_the_cache_is_replaced(suffix: str, damage: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    assert compiled(_doubled)(1.0) == 2.0
    (file,) = tmp_path.rglob(f"*{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    assert compiled(_doubled)(1.0) == 2.0
    third: Any = compiled(_doubled)
    assert third(1.0) == 2.0
    assert third.stats.cache_hits


def test_a_kill_between_index_and_data_leaves_no_code_of_older_sources(tmp_path: Path, monkeypatch: Any) -> None:
    def kill(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    assert compiled(_scaled)(1.0) == 2.0
    monkeypatch.setattr(module, "_source_stamp", lambda _: ("changed",))
    monkeypatch.setitem(globals(), "_factor", 3.0)
    with monkeypatch.context() as context:
        context.setattr(IndexDataCacheFile, "_save_data", kill)
        with pytest.raises(KeyboardInterrupt):
            compiled(_scaled)(1.0)
    assert compiled(_scaled)(1.0) == 3.0


FULL_DISK = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # bytes of a file
from quadpend_gym import Reference
print(Reference.circle(1.0, 1.0).derivatives(0.0)[0, 1])
"""


def test_a_full_disk_is_a_warning(tmp_path: Path) -> None:
    done = run(ROOT, FULL_DISK, NUMBA_CACHE_DIR=str(tmp_path))
    assert float(done.stdout) == 0.0
    assert done.stderr.count("RuntimeWarning: numba cannot write its cache") == 1


COMPILES = "from quadpend_gym.core import jit; jit._PATIENCE = 0.0; " + CIRCLE


def test_a_process_says_once_that_it_compiles(tmp_path: Path) -> None:
    first, second = (run(ROOT, COMPILES, NUMBA_CACHE_DIR=str(tmp_path)).stderr for _ in range(2))
    assert first.startswith("quadpend_gym compiles")
    assert first.count("\n") == 1
    assert second == ""


def test_functions_of_users_compile_as_ever() -> None:
    """Numba compiles the loop as a function of its own."""

    @jit(forceobj=True, looplift=True)
    def total(n: int) -> int:
        result = 0
        for i in range(n):
            result += i
        return result

    assert total(5) == 10


def test_with_a_newer_numba_inlined_functions_only_compile_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_IS_KNOWN", False)
    inner: Any = inlined(_doubled)
    assert compiled(lambda x: inner(x) + 1.0)(1.0) == 3.0
    assert inner(1.0) == 2.0
