"""Every command ends at once after one or two signals at any moment, and resumes to the same results."""

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import interruptions
from quadpend_train.cli.main import main
from quadpend_train.cli.training import how_to_continue
from quadpend_train.common import interruption

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the process table of Linux")
COMMANDS = interruptions.commands(1)


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_ends_at_once_and_resumes_to_the_same_results(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, draw = COMMANDS[name], random.Random(name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["__main__.py", *command.arguments])
    main(list(command.arguments))
    moments = [draw.uniform(*limits) for limits in ((0.0, 1.0), (1.0, 3.0))]
    interruptions.interrupt_and_resume(command, moments, draw, command.results(tmp_path))


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
