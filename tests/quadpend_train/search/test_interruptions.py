"""A study goes on after a signal or a kill at any write to its file, and needs nothing that Windows lacks."""

import math
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import optuna
import pytest
from optuna.distributions import FloatDistribution

from quadpend_train.search.shared import finished, open_study, run_trials

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
# Each process of the loop ends at one of the first writes to the file of the study. Then the search continues.
PROGRAM = """
import os, sys
from pathlib import Path
from tests.quadpend_train.search.test_interruptions import search
from quadpend_train.cli import main

main._run, number, fsync, sys.argv = search, int(sys.argv[1]), os.fsync, ["quadpend"]
search()  # what it imports is then there for all processes
for last in range(1, 15):
    Path("trials.log").unlink(missing_ok=True)
    if not os.fork():
        writes = []
        def write(file):
            fsync(file)
            writes.append(file)
            if len(writes) == last:
                os.kill(os.getpid(), number)
        os.fsync = write
        main.main()
    print(os.waitstatus_to_exitcode(os.wait()[1]), *search())
"""


def search(_: object = None) -> tuple[int, bool]:
    """Return the number of different trials of a search that is to have four, and whether the first is the start."""
    study = open_study("study", "trials.log", optuna.samplers.RandomSampler, 0, {"x": 1.0})
    run_trials(study, {"x": FloatDistribution(0.0, 2.0)}, lambda trial: float(trial.params["x"]), 4, False)
    assert all(trial.values == [trial.params["x"]] for trial in finished(study))
    return len({trial.value for trial in finished(study)}), finished(study)[0].value == 1.0


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_study_continues_after_a_signal_at_any_write(tmp_path: Path, number: int, status: int) -> None:
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", PROGRAM, str(int(number))]
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=200.0)
    lines = done.stdout.splitlines()
    assert len(lines) == 14, done.stderr
    # A running trial is lost by a kill, even the start, but not by a signal.
    assert set(lines) <= {f"{status} 4 True"} | ({f"{status} 4 False"} if number == signal.SIGKILL else set())
    assert not set(done.stderr.splitlines()) - {
        "",
        "Interrupted: what is finished is saved, and the same command continues",
    }


def test_a_study_needs_no_symbolic_links_and_stays_in_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On Windows a symbolic link needs a privilege; own code may change the folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delattr(os, "symlink")
    study = open_study("study", "trials.log", optuna.samplers.RandomSampler, 0, {"x": 1.0})
    (tmp_path / "other").mkdir()
    monkeypatch.chdir("other")
    run_trials(study, {"x": FloatDistribution(0.0, 2.0)}, lambda trial: 1.0, 2, False)
    assert len(finished(study)) == 2
    assert not [*Path().iterdir()]


def test_a_trial_without_a_value_fails_and_the_study_goes_on_in_any_thread() -> None:
    study, values = optuna.create_study(), iter([math.nan, 1.0, 2.0])
    with ThreadPoolExecutor(1) as pool, pytest.warns(UserWarning, match="nan"):
        pool.submit(run_trials, study, {}, lambda trial: next(values), 2, False).result()
    assert [trial.state.name for trial in study.trials] == ["FAIL", "COMPLETE", "COMPLETE"]
