"""A change of a function invalidates the cache of those that inline it, and compilation changes no number."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.helpers.sources import ROOT

CIRCLE = "from quadpend_gym import Reference; print(Reference.circle(1.0, 1.0).derivatives(0.0)[0, 1])"


def output(folder: Path, script: str, **variables: str) -> str:
    """Return the output of a script in a process of its own, which imports quadpend_gym from `folder`."""
    environment = {**os.environ, "PYTHONPATH": str(folder), **variables}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout


def test_a_change_of_an_inlined_function_in_another_file_invalidates_the_cache(tmp_path: Path) -> None:
    """`references._evaluate` inlines `sincos` of `elementary.py`: adding one to every sine shifts the circle."""
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
