"""Ctrl-C, SIGTERM and SIGKILL: a command ends soon, leaves nothing behind, and continues."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the process table of Linux")
SECONDS = 20.0  # on a busy machine; on an idle one, a command ends within one or two
SMALL = ["--num-envs", "16", "--set", "ppo.batch_size=128", "--n-eval-episodes", "2", "--save-freq", "4096"]
TRAIN = ["train", "--settings", "ppo", "--out", "run", *SMALL]
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
EVALUATE = ["evaluate", "slow:SlowPolicy", "--scenarios", "calm", "breeze", "--episodes", "7", "--jobs"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "slow.py").write_text(SLOW_POLICY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def start(arguments: list[str], begun: Callable[[], bool]) -> "subprocess.Popen[str]":
    """Start a command in a session of its own, and wait until it has begun its work."""
    process = subprocess.Popen(
        [sys.executable, "-m", "quadpend_train", *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    latest = time.monotonic() + 120.0
    while not begun():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < latest
        time.sleep(0.05)
    return process


def running(count: int) -> bool:
    return len(list(Path().glob("*.running"))) == count


def processes_of(session: int) -> list[str]:
    """The command lines of the processes of a session that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, _, of_session = path.read_text(errors="replace").rpartition(")")[2].split()[:4]
            command = path.with_name("cmdline").read_text(errors="replace")  # empty if the process is about to end
            if int(of_session) == session and state not in "ZX" and command:
                found.append(command)
    return found


@pytest.mark.parametrize(
    ("arguments", "begun", "number", "times", "advice"),
    [
        (TRAIN, lambda: Path("run/checkpoint.zip").exists(), signal.SIGINT, 1, "`quadpend train --resume run` cont"),
        ([*EVALUATE, "2"], lambda: running(2), signal.SIGINT, 2, "what is finished is saved, and the same command"),
        (
            ["tune", "lqr", "--scenarios", "calm", "--episodes", "4", "--out", "out"],
            lambda: Path("out/trials.log").exists(),
            signal.SIGTERM,
            1,
            "what is finished is saved, and the same command continues",
        ),
    ],
    ids=["train", "two processes", "tune"],
)
@pytest.mark.usefixtures("folder")
def test_an_interrupted_command_ends_soon_and_leaves_nothing_behind(
    arguments: list[str], begun: Callable[[], bool], number: signal.Signals, times: int, advice: str
) -> None:
    process = start(arguments, begun)
    try:
        begin = time.monotonic()
        for _ in range(times):  # Ctrl-C goes to all processes in the terminal, SIGTERM to the command only
            (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
            time.sleep(0.05)
        output, _ = process.communicate(timeout=120.0)
        assert time.monotonic() - begin < SECONDS
        assert processes_of(process.pid) == []
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 128 + number, output
    assert output.splitlines()[-1].startswith(f"Interrupted: {advice}"), output
    assert "Traceback" not in output
    assert not list(Path().rglob("unfinished*"))


@pytest.mark.parametrize("call", ["callback()", "exec('os.kill(os.getpid(), signal.SIGTERM)')"])
def test_an_interruption_is_not_lost_in_a_callback_of_c_or_in_exec(call: str, tmp_path: Path) -> None:
    """An exception cannot leave such a callback, and `python -m` changes its status after one in `exec`."""
    program = f"""if True:
        import ctypes, os, signal, sys, time
        from quadpend_train.cli import main
        callback = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM))
        main._run = lambda arguments: ({call}, time.sleep(60.0))
        sys.argv = ["quadpend"]
        main.main()"""
    (tmp_path / "program.py").write_text(program)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "program"], env=env, capture_output=True, text=True, timeout=50.0)
    assert time.monotonic() - begin < SECONDS
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr.strip() == "Interrupted"


@pytest.mark.usefixtures("folder")
def test_a_killed_training_resumes_to_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    length = ["--total-timesteps", "16384", "--eval-freq", "4096"]
    process = start([*TRAIN, *length], lambda: Path("run/checkpoint.zip").exists())
    process.kill()
    process.communicate()
    assert not Path("run/policy.npz").exists()
    Path("run/unfinished_1_curve.csv").touch()  # as if it was killed while it wrote
    main(["train", "--resume", "run"])
    assert MlpPolicy.load("run/policy.npz").card["steps"] == 16384
    assert not [path.name for path in Path("run").iterdir() if re.match("checkpoint|unfinished", path.name)]
    assert "Trained policy: run/policy.npz" in capsys.readouterr().out
