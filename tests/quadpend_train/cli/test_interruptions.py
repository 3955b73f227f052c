"""Every command ends at once after one or two signals at any moment, and resumes to the same results."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks import interruptions
from quadpend_train.cli.main import main
from quadpend_train.cli.training import how_to_continue
from quadpend_train.common import interruption
from quadpend_train.training import train as training
from quadpend_train.training.run_folder import write_json
from quadpend_train.training.settings import to_mapping
from tests.helpers.training import BRIEF

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the process table of Linux")
COMMANDS = interruptions.commands(1)
_MOST_SECONDS = 20.0  # on a busy machine; `make interruptions` checks the two seconds


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_ends_at_once_and_resumes_to_the_same_results(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, draw = COMMANDS[name], random.Random(name)
    start = tmp_path / "start"
    start.mkdir()

    def run(arguments: tuple[str, ...], folder: Path) -> None:
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", ["__main__.py", *arguments])
        main(list(arguments))

    if command.before:
        run(command.before, start)
    whole = shutil.copytree(start, tmp_path / "whole")
    run(command.arguments, whole)
    moments = [draw.uniform(*limits) for limits in ((0.0, 1.0), (1.0, 3.0))]
    interruptions.interrupt_and_resume(command, start, moments, draw, command.results(whole), _MOST_SECONDS)


SLOW_POLICY = """
import os, subprocess, time
from pathlib import Path

class SlowPolicy:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 7:  # an evaluation
            subprocess.Popen(["sleep", "60"])
            Path(f"{os.getpid()}.running").touch()
            time.sleep(60.0)
        return observation[..., :4], state
"""


@pytest.mark.parametrize(
    ("jobs", "signals"),
    [(1, [signal.SIGINT]), (2, [signal.SIGINT]), (2, [signal.SIGTERM] * 2)],
    ids=["one process", "two processes", "SIGTERM twice"],
)
def test_a_command_does_not_wait_for_the_end_of_an_evaluation(
    jobs: int, signals: list[signal.Signals], tmp_path: Path
) -> None:
    """Nor do its processes, and those that the policy has started."""
    (tmp_path / "slow.py").write_text(SLOW_POLICY)
    command = ["evaluate", "slow:SlowPolicy", "--scenarios", "calm", "breeze", "--episodes", "7", "--jobs", str(jobs)]
    process, latest = interruptions.start(command, tmp_path), time.monotonic() + 120.0
    try:
        while len(list(tmp_path.glob("*.running"))) < jobs:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < latest
            time.sleep(0.05)
        interruptions.end(process, tmp_path, signals, 0.05, _MOST_SECONDS)
    finally:
        process.kill()


def test_a_program_that_calls_commands_keeps_its_signal_handlers(capsys: pytest.CaptureFixture[str]) -> None:
    before = [signal.getsignal(number) for number in interruption.SIGNALS]
    main(["--version"])
    assert [signal.getsignal(number) for number in interruption.SIGNALS] == before
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ()) & set(interruption.SIGNALS)


def test_an_interrupted_training_says_how_it_continues(tmp_path: Path) -> None:
    assert how_to_continue(tmp_path) == ""
    (tmp_path / "settings.json").touch()
    assert how_to_continue(tmp_path) == f"`quadpend train --resume {tmp_path}` continues the run"
    (tmp_path / "policy.npz").touch()
    assert how_to_continue(tmp_path) == f"the run in {tmp_path} is finished"


def test_an_interrupted_continuation_says_how_it_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same command continues it only before it has begun."""
    sentences, policy = [], tmp_path / "policy.npz"

    def interrupted(*_: Any, **__: Any) -> None:
        for change in (lambda: None, lambda: policy.rename(tmp_path / "policy_8.npz"), policy.touch):
            change()
            sentences.append(interruption.sentence())
        raise KeyboardInterrupt

    for path in (policy, tmp_path / "policy_4.npz"):
        path.touch()
    write_json(tmp_path / "settings.json", to_mapping(BRIEF))
    monkeypatch.setattr(training, "extend", interrupted)
    with pytest.raises(SystemExit, match="130"):
        main(["train", "--resume", str(tmp_path), "--more-steps", "8"])
    assert sentences == [
        "Interrupted: the same command continues",
        f"Interrupted: `quadpend train --resume {tmp_path}` continues the run",
        f"Interrupted: the run in {tmp_path} is finished",
    ]


def test_a_file_begun_during_the_end_of_a_command_is_not_left(tmp_path: Path) -> None:
    code = f"""
import os, signal, time
from pathlib import Path
from quadpend_train.common import interruption
from quadpend_train.common.files import write_text
interruption.advise(lambda: time.sleep(0.3) or "")
interruption.end_at_signals()
os.kill(os.getpid(), signal.SIGINT)
while True:
    write_text(Path({str(tmp_path)!r}, "file"), "text" * 10_000)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, check=False, timeout=60.0)
    assert ended.returncode == 130
    assert {path.name for path in tmp_path.iterdir()} <= {"file"}
