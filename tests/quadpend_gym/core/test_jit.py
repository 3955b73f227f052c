"""The cache of compiled functions notices an edit of anything they inline."""

import shutil
import subprocess
import sys
from pathlib import Path

from tests.helpers.sources import ROOT

SHOW = "from quadpend_gym import Reference; print(Reference.circle(1.0, 1.0).derivatives(0.0)[0, 1])"


def test_an_edit_in_an_inlined_function_of_another_file_is_noticed(tmp_path: Path) -> None:
    """`references._evaluate` inlines `sincos` of `elementary.py`: if every sine grows by one, the circle shifts."""
    shutil.copytree(ROOT / "quadpend_gym", tmp_path / "quadpend_gym", ignore=shutil.ignore_patterns("__pycache__"))

    def shown() -> float:
        run = subprocess.run([sys.executable, "-c", SHOW], cwd=tmp_path, capture_output=True, text=True, check=True)
        return float(run.stdout)

    assert shown() == 0.0
    edited = tmp_path / "quadpend_gym/core/elementary.py"
    edited.write_text(edited.read_text().replace("return sine, cosine", "return sine + 1.0, cosine"))
    assert shown() == 1.0
