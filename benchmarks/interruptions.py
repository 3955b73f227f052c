"""Interrupt commands at random moments, resume them, and compare the results with those of an uninterrupted command.

`make interruptions` runs this file as ``python -m benchmarks.interruptions``. It sends one or two SIGINT (to the whole
process group, like Ctrl-C) or SIGTERM (to the process alone). A command must end within two seconds, with status 130 or
143, one line on how to go on, no traceback, no process and no half-written file. Then it is resumed to its end; if it
has workers, one of them is killed meanwhile. The first moments, before the command handles signals, are not tested. It
needs Linux.
"""

import argparse
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from quadpend_train.policies.mlp_policy import MlpPolicy

_END_SECONDS, _LONGEST_SECONDS = 2.0, 120.0
_STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
Results = dict[str, bytes]


def _weights(folder: Path) -> Results:
    """Return the weights of a trained policy, and its learning curve without the times."""
    layers = MlpPolicy.load(folder / "run/policy.npz").layers
    curve = [line.split(",") for line in (folder / "run/curve.csv").read_text(encoding="utf-8").splitlines()]
    return {
        "weights": b"".join(part.tobytes() for layer in layers for part in layer),
        "curve": json.dumps([cells[:1] + cells[2:] for cells in curve]).encode(),
    }


def _files(folder: Path) -> Results:
    """Return the contents of all files by their relative paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


class Command(NamedTuple):
    """A command, and a function that returns what must not depend on interruptions.

    Attributes:
        arguments: Arguments of the command.
        results: Function that returns the results of a folder.
        before: Arguments of a command that is run first, in an empty folder, and not interrupted; none without it.
    """

    arguments: tuple[str, ...]
    results: Callable[[Path], Results] = _files
    before: tuple[str, ...] = ()

    def continuing(self, folder: Path) -> list[str]:
        """Return the arguments that begin the command or continue it; none if it is finished."""
        run = folder / "run"
        begun = any(run.glob("policy_*.npz" if self.before else "settings.json"))
        if self.arguments[0] != "train" or not begun:
            return list(self.arguments)
        return [] if (run / "policy.npz").exists() else ["train", "--resume", "run"]


def commands(size: int) -> dict[str, Command]:
    """Return the commands; their work grows with `size`."""
    steps, calm, windy = 2048 * size, *(json.dumps({"wind": wind, "duration": 2.0}) for wind in ("calm", "windy"))
    scenarios = ("--scenarios", f"calm={calm}", f"windy={windy}")
    training = ("--total-timesteps", 2 * steps, "--eval-freq", steps // 2, "--save-freq", steps // 4)
    network = ("--num-envs", 16, "--batch-size", 128, "--net-arch", 16, "--n-eval-episodes", 2)
    first: tuple[object, ...] = ("train", "--settings", "ppo", "--out", "run", *training, *network)
    everything: dict[str, tuple[object, ...]] = {
        "train": first,
        "train more": ("train", "--resume", "run", "--more-steps", 2 * steps),
        "evaluate": (
            "evaluate",
            "flatness",
            "lqr",
            *scenarios,
            "--episodes",
            100 * size,
            "--replay",
            size // 4,
            "--jobs",
            2,
            "--out",
            "out",
        ),
        "tune": ("tune", "lqr", "--scenarios", calm, "--trials", 2 * size, "--episodes", 4, "--out", "out"),
        "watch": ("watch", "flatness", "--scenarios", "calm", "--seconds", 0, size / 4, "--out", "video.gif"),
    }
    return {
        name: Command(
            tuple(map(str, arguments)),
            _weights if arguments[0] == "train" else _files,
            tuple(map(str, first)) if name == "train more" else (),
        )
        for name, arguments in everything.items()
    }


def start(arguments: list[str], folder: Path) -> "subprocess.Popen[str]":
    """Start a command in a session of its own, and wait until it handles signals."""
    process = subprocess.Popen(
        [sys.executable, "-m", "quadpend_train", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    while process.poll() is None and not _blocks_signals(process.pid):
        time.sleep(0.001)
    return process


def _blocks_signals(process: int) -> bool:
    with suppress(OSError):
        found = re.search(r"^SigBlk:\s*(\w+)", Path(f"/proc/{process}/status").read_text(), re.MULTILINE)
        return bool(found and int(found[1], 16) & (1 << (signal.SIGTERM - 1)))
    return False


def run(arguments: list[str], folder: Path, kill_after: float = float("inf")) -> float:
    """Run a command to its end, and return its duration after its start, s.

    Args:
        arguments: Arguments of the command.
        folder: Folder in which it runs.
        kill_after: Time after which one worker of the command, if it has any, is killed with SIGKILL, s.
    """
    process, begin = start(arguments, folder), time.perf_counter()
    while True:
        try:
            output, _ = process.communicate(timeout=0.05)
            break
        except subprocess.TimeoutExpired:
            assert time.perf_counter() - begin < _LONGEST_SECONDS, "the command hangs"
            workers = [number for number, name in _processes_of(process.pid).items() if "spawn_main" in name]
            if workers and time.perf_counter() - begin > kill_after:
                os.kill(workers[0], signal.SIGKILL)
                kill_after = float("inf")
    assert process.returncode == 0, output
    return time.perf_counter() - begin


def interrupt(
    arguments: list[str],
    folder: Path,
    moment: float,
    signals: list[signal.Signals],
    pause: float,
    most: float = _END_SECONDS,
) -> float:
    """Start a command, send signals, and check how it ends.

    Args:
        arguments: Arguments of the command.
        folder: Folder in which it runs.
        moment: Time of the first signal after the start, s.
        signals: As for `end`.
        pause: As for `end`.
        most: As for `end`.

    Returns:
        The time between the first signal and the end of the command, s; nan if it ended before.
    """
    process = start(arguments, folder)
    with suppress(subprocess.TimeoutExpired):
        process.wait(moment)
    return end(process, folder, signals, pause, most)


def end(
    process: "subprocess.Popen[str]", folder: Path, signals: list[signal.Signals], pause: float, most: float
) -> float:
    """Send signals to a command, and check how it ends.

    Args:
        process: Process of the command.
        folder: Folder in which it runs.
        signals: Signals, all the same.
        pause: Time between two signals, s.
        most: Largest permitted time between the first signal and the end of the command, s.

    Returns:
        The time between the first signal and the end of the command, s; nan if it ended before.
    """
    finished, begin = process.poll() is not None, time.perf_counter()
    for number in signals:
        with suppress(ProcessLookupError):
            (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        if len(signals) > 1:
            time.sleep(pause)
    try:
        output, _ = process.communicate(timeout=_LONGEST_SECONDS)
        seconds = time.perf_counter() - begin
        left = _processes_of(process.pid)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    check_files(folder)
    assert "Traceback" not in output, output
    if finished or process.returncode == 0:  # it ended before the signal arrived
        assert process.returncode == 0, output
        return float("nan")
    assert not left, f"processes are left: {left}"
    assert process.returncode == _STATUS[signals[0]], f"status {process.returncode}: {output}"
    assert output.count("Interrupted: ") == 1, output
    assert output.rstrip("\n").rpartition("\n")[2].startswith("Interrupted: "), output
    assert seconds < most, f"the command ended after {seconds:.1f} s"
    return seconds


def _processes_of(session: int) -> dict[int, str]:
    """Return the command lines of the processes of a session, without those that have ended, by their number."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, _, of_session = path.read_text(errors="replace").rpartition(")")[2].split()[:4]
            if int(of_session) == session and state not in "ZX":
                found[int(path.parent.name)] = path.with_name("cmdline").read_text(errors="replace")
    return found


def check_files(folder: Path) -> None:
    """Check that no temporary file is in a folder, and that its files are complete."""
    for path in (path for path in folder.rglob("*") if path.is_file()):
        assert "unfinished" not in path.name, path
        assert ".tmp" not in path.name, path
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        if path.suffix in (".npz", ".zip"):
            with zipfile.ZipFile(path) as archive:
                assert archive.testzip() is None, path


def interrupt_and_resume(
    command: Command,
    start_folder: Path,
    moments: list[float],
    draw: random.Random,
    expected: Results,
    most: float = _END_SECONDS,
) -> list[float]:
    """Interrupt a command at each of these moments, resume it to its end, and compare its results.

    Args:
        command: The command; it runs in a new folder, in which it is continued after each interruption.
        start_folder: Folder of which the new folder is a copy.
        moments: Times of the interruptions after the start of the command, s.
        draw: Source of the kind and the number of the signals.
        expected: Results of the uninterrupted command.
        most: Largest permitted time of an interruption, s.

    Returns:
        The time that each interruption took, s.
    """
    taken = []
    with tempfile.TemporaryDirectory() as name:
        folder = shutil.copytree(start_folder, Path(name, "copy"))
        for moment in moments:
            if arguments := command.continuing(folder):
                signals = [draw.choice(list(_STATUS))] * draw.choice((1, 2))
                taken.append(interrupt(arguments, folder, moment, signals, draw.uniform(0.0, 0.2), most))
        if arguments := command.continuing(folder):
            run(arguments, folder, kill_after=draw.uniform(1.0, 4.0))
        found = command.results(folder)
    assert found.keys() == expected.keys(), sorted(found.keys() ^ expected.keys())
    different = [name for name, value in expected.items() if found[name] != value]
    assert not different, f"different after an interruption: {different}"
    return taken


def uninterrupted(command: Command, start_folder: Path) -> tuple[Results, float]:
    """Return the results of a command that is not interrupted, and its duration, s."""
    with tempfile.TemporaryDirectory() as name:
        folder = shutil.copytree(start_folder, Path(name, "copy"))
        seconds = run(list(command.arguments), folder)
        return command.results(folder), seconds


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="commands; all by default")
    parser.add_argument("--moments", type=int, default=20, help="interrupted runs of each command")
    parser.add_argument("--size", type=int, default=8, help="amount of work of the commands")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    options = parser.parse_args()
    for name, command in commands(options.size).items():
        if options.names and name not in options.names:
            continue
        draw = random.Random(options.seed)
        taken: list[float] = []
        with tempfile.TemporaryDirectory() as start_folder:
            if command.before:
                run(list(command.before), Path(start_folder))
            expected, duration = uninterrupted(command, Path(start_folder))
            while sum(map(math.isfinite, taken)) < options.moments:
                moment = draw.uniform(0.0, duration)
                taken += interrupt_and_resume(command, Path(start_folder), [moment], draw, expected)
        ended = list(filter(math.isfinite, taken))
        print(
            f"{name}: {len(ended)} runs of {duration:.1f} s interrupted, each at most {max(ended):.2f} s, and"
            f" {len(taken) - len(ended)} that ended before; all resumed to the same results.",
            flush=True,
        )


if __name__ == "__main__":
    main()
