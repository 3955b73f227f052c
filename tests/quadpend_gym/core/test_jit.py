"""Compiled functions work with and without a cache, which a change of a function that they inline invalidates."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.sources import ROOT

SCRIPT = "from quadpend_gym import Reference; print(Reference.circle(1.0, 1.0).derivatives(0.0)[0, 1])"


def test_a_change_of_an_inlined_function_in_another_file_invalidates_the_cache(tmp_path: Path) -> None:
    """`references._evaluate` inlines `sincos` of `elementary.py`: adding one to every sine shifts the circle."""
    shutil.copytree(ROOT / "quadpend_gym", tmp_path / "quadpend_gym", ignore=shutil.ignore_patterns("__pycache__"))

    def output() -> float:
        run = subprocess.run([sys.executable, "-c", SCRIPT], cwd=tmp_path, capture_output=True, text=True, check=True)
        return float(run.stdout)

    assert output() == 0.0
    edited = tmp_path / "quadpend_gym/core/elementary.py"
    edited.write_text(edited.read_text().replace("return sine, cosine", "return sine + 1.0, cosine"))
    assert output() == 1.0


def run(folder: Path, script: str = SCRIPT, **variables: str) -> tuple[str, str]:
    """Return output and errors of a script in a process of its own, which imports quadpend_gym from `folder`."""
    environment = {**os.environ, "PYTHONPATH": str(folder), **variables}
    command = [sys.executable, "-c", script]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return run.stdout, run.stderr


@pytest.fixture
def package_without_cache(tmp_path: Path) -> Path:
    """A copy of the package whose folders numba cannot write, also not as root: each __pycache__ is a file."""
    shutil.copytree(ROOT / "quadpend_gym", tmp_path / "quadpend_gym", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in {file.parent for file in tmp_path.rglob("*.py")}:
        (folder / "__pycache__").touch()
    return tmp_path


def test_without_a_folder_for_the_cache_there_is_one_warning(package_without_cache: Path) -> None:
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "NUMBA_CACHE_DIR": ""}
    out, errors = run(package_without_cache, **nowhere)
    assert float(out) == 0.0
    assert errors.count("cannot write its cache") == 1
    assert "NUMBA_CACHE_DIR" in errors
    assert "Traceback" not in errors


STEPS = """
import numpy as np
from quadpend_gym import QuadPendulumEnv
env = QuadPendulumEnv(wind="windy")
print(env.reset(seed=0)[0].tolist(), *(env.step(np.full(4, 0.1, np.float32))[:2] for _ in range(2)))
"""


def test_without_compilation_the_numbers_are_the_same() -> None:
    assert run(ROOT, STEPS, NUMBA_DISABLE_JIT="1") == run(ROOT, STEPS)
