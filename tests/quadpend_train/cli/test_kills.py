"""A training that was killed at a file operation ends with the results of an undisturbed one, see `make kills`."""

import subprocess
import sys

import pytest

from tests.helpers.sources import ROOT


@pytest.mark.skipif(sys.platform == "win32", reason="it needs fork and SIGKILL")
@pytest.mark.parametrize(
    ("options", "count"),
    [(["train", "--most", "2"], 2), (["train more", "--files", ".json"], 10)],
    ids=["training", "begin of a continuation"],
)
def test_killed_training_resumes_to_the_same_results(options: list[str], count: int) -> None:
    command = [sys.executable, "-m", "tests.helpers.kills", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(f"killed at {count} operations, 0 without the results") == 1
