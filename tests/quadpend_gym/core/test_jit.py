"""The cache of compiled functions is invalidated when a function that they inline changes."""

import shutil
import subprocess
import sys
from pathlib import Path

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
