"""Several processes share the trials of a search, and a killed process costs its running trial only."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.trial import TrialState

from quadpend_train.studies.search import shared_trials
from quadpend_train.studies.search.shared_trials import open_storage, open_study, run_trials
from tests.helpers.search import START, distance, open_test_study, sampler


def work(storage: str, trials: int, seconds: float, begun: Path, processes: int = 1) -> subprocess.Popen[bytes]:
    """Start one of some processes that take trials, each of which lasts some seconds."""
    options = [storage, str(trials), str(seconds), str(begun), str(processes)]
    command = [sys.executable, "-m", "tests.helpers.search", *options]
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})


def wait_for(path: Path) -> None:
    """Wait until a file exists."""
    end = time.monotonic() + 60.0
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("kind", ["journal", "database"])
def test_two_processes_share_the_trials(kind: str, tmp_path: Path) -> None:
    storage = str(tmp_path / "search.log") if kind == "journal" else f"sqlite:///{tmp_path}/search.db"
    workers = [work(storage, 10, 0.02, tmp_path / f"begun{number}", 2) for number in range(2)]
    assert [worker.wait(60.0) for worker in workers] == [0, 0]
    trials = open_test_study(storage).trials
    assert all(trial.state == TrialState.COMPLETE for trial in trials)
    assert 10 <= len(trials) <= 11
    assert trials[0].params == START
    assert len({str(trial.params) for trial in trials}) == len(trials)
    made_by = [trial.user_attrs["process"][1] for trial in trials]
    assert set(made_by) == {process.pid for process in workers}


@pytest.mark.skipif(sys.platform == "win32", reason="it needs SIGKILL")
def test_a_killed_process_costs_its_running_trial_which_the_next_process_makes_again(tmp_path: Path) -> None:
    storage = str(tmp_path / "search.log")
    run_trials(open_test_study(storage), distance, 3, progress=False)
    worker = work(storage, 6, 60.0, tmp_path / "begun")
    wait_for(tmp_path / "begun")
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    study = open_test_study(storage)
    (lost,) = study.get_trials(states=(TrialState.RUNNING,))
    run_trials(study, distance, 6, progress=False)
    done = study.get_trials(states=(TrialState.COMPLETE,))
    assert len(done) == 6
    assert [trial.number for trial in done if trial.params == lost.params] == [lost.number + 1]
    assert len(open_test_study(storage).trials) == 7  # it is made again once


def test_a_process_killed_before_its_first_value_costs_no_start(tmp_path: Path) -> None:
    storage = str(tmp_path / "search.log")
    lost = open_test_study(storage).ask()
    lost.set_user_attr("process", (socket.gethostname(), os.getpid()))
    trial = open_test_study(storage).ask()
    distance(trial)
    assert trial.number == 1
    assert trial.params == START


def test_two_processes_find_what_one_finds() -> None:
    best = []
    for processes in (1, 2):
        values = []
        for seed in range(3):
            study = open_study(str(seed), optuna.storages.InMemoryStorage(), sampler(seed))
            running: list[tuple[optuna.Trial, float]] = []
            for _ in range(120):
                if len(running) == processes:
                    study.tell(*running.pop(0))
                trial = study.ask()
                running.append((trial, distance(trial)))
            values.append(study.best_value)
        best.append(max(values))
    assert best[0] < 0.05
    assert best[1] < 0.05


def test_trials_depend_on_the_seed_and_their_number() -> None:
    made = []
    for seed in (0, 0, 1):
        study = open_study("test", optuna.storages.InMemoryStorage(), sampler(seed))
        run_trials(study, distance, 4, progress=False)
        made.append([trial.params for trial in study.trials])
    assert made[0] == made[1]
    assert made[0][1:] != made[2][1:]


@pytest.mark.parametrize("storage", ["folder", "settings.toml", "oracle7://x", "sqlite:////no/such/folder/a.db", "://"])
def test_a_wrong_storage_is_refused_in_one_sentence(
    storage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "settings.toml").write_text('[a]\nb = 1\nalgo = "ppo"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"^storage must be a file") as raised:
        open_storage(storage)
    assert "\n" not in str(raised.value)


def test_the_password_of_a_database_is_not_shown() -> None:
    url = "postgresql://me:secret@host/search"
    assert "secret" not in shared_trials.describe_storage(url)
    with pytest.raises(ValueError, match=r"postgresql\+nodriver://…") as raised:
        open_storage("postgresql+nodriver://me:secret@host/search")
    assert "secret" not in str(raised.value)


def is_lost(process: Any) -> bool:
    """Whether the trial of a process is lost."""
    return shared_trials._is_lost(optuna.trial.create_trial(state=TrialState.RUNNING, user_attrs={"process": process}))


def test_trials_of_other_machines_and_of_living_processes_are_not_lost() -> None:
    assert not is_lost(["elsewhere", 2**22 + 1])
    assert not is_lost([socket.gethostname(), os.getppid()])
