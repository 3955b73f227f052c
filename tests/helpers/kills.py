"""Kill commands at each of their file operations, run them again, and compare the results with an undisturbed run.

`make kills` runs this file as ``python -m tests.helpers.kills``. An operation is the creation or removal of a folder,
the opening of a file for writing, a write (half of the bytes), a rename, and the removal of a file. A command
runs in a fork of this process, so that libraries are imported once, and is killed with SIGKILL. TensorBoard's event
files, which another thread writes and no command reads, are left out. It needs a POSIX system.
"""

import argparse
import builtins
import io
import json
import os
import shutil
import signal
import sys
import tempfile
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.studies.search import tuning  # noqa: F401 (imported before the fork)
from quadpend_train.training import train as training
from quadpend_train.training.validation import validate
from tests.helpers.training import BRIEF

_SECONDS = 120  # a command that takes longer hangs
_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate")
_PARTS = ("training", "evaluation", "studies")
_open = io.open


class Operations:
    """Count the file operations below a folder, and kill this process at one of them.

    Args:
        folder: The folder.
        kill_at: Number of the operation, from 1; 0 to count only.
        files: Part of the names of the files whose operations count.
    """

    def __init__(self, folder: Path, kill_at: int, files: str = "") -> None:
        self.folder, self.kill_at, self.files, self.count = str(folder.resolve()), kill_at, files, 0
        sys.addaudithook(self._before_event)
        io.open = builtins.open = self._open_file  # type: ignore[assignment]

    def next_is_last(self) -> bool:
        """Count an operation, and return whether the process is to be killed in it."""
        self.count += 1
        return self.count == self.kill_at

    def _counts(self, path: Any) -> bool:
        if isinstance(path, int) or not isinstance(path, str | bytes | os.PathLike):
            return False
        full = os.path.abspath(os.fsdecode(path))
        return full.startswith(self.folder) and "events.out" not in full and self.files in os.path.basename(full)

    def _before_event(self, event: str, arguments: tuple[Any, ...]) -> None:
        changes = event in _CHANGES
        if event == "open":
            changes = bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)) if arguments[2] else False
        if changes and self._counts(arguments[0]) and self.next_is_last():
            os.kill(os.getpid(), signal.SIGKILL)

    def _open_file(self, file: Any, mode: str = "r", buffering: int = -1, *rest: Any, **options: Any) -> Any:
        if "opener" in options or not self._counts(file) or not set(mode) & set("wax+"):
            return _open(file, mode, buffering, *rest, **options)
        raw = _KillingFile(file, mode.replace("b", "").replace("t", ""))
        raw.operations = self
        if buffering == 0:
            return raw
        buffer: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffer if "b" in mode else io.TextIOWrapper(buffer, *rest, **options)


class _KillingFile(io.FileIO):
    """A file that is killed with half of the bytes written."""

    operations: Operations

    def write(self, data: Any) -> int:
        if not self.operations.next_is_last():
            return super().write(data)
        super().write(bytes(data)[: len(data) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


def _trained(folder: Path) -> dict[str, Any]:
    """Return weights, score and curve of a training without its times."""
    found: dict[str, Any] = {}
    for name in ("policy.npz", "best.npz"):
        found[name] = [part.tobytes() for layer in MlpPolicy.load(folder / "run" / name).layers for part in layer]
    found["score"] = MlpPolicy.load(folder / "run/policy.npz").card["score"]
    rows = [line.split(",") for line in (folder / "run/curve.csv").read_text().splitlines()]
    found["curve"] = [cells[:1] + cells[2:] for cells in rows]
    found["names"] = sorted(path.name for path in (folder / "run").iterdir() if "events" not in path.name)
    found["settings"] = (folder / "run/settings.json").read_bytes()
    found["continued_at"] = json.loads((folder / "run/provenance.json").read_bytes()).get("continued_at")
    return found


def _written(folder: Path) -> dict[str, Any]:
    """Return all files; archives by their parts, since their headers have times."""
    found: dict[str, Any] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = str(path.relative_to(folder))
        if path.suffix == ".npz" and zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                found[name] = {part: archive.read(part) for part in archive.namelist()}
        else:
            found[name] = path.read_bytes()
    return found


class Command(NamedTuple):
    """A command, and a function that returns what must not depend on kills.

    Attributes:
        arguments: Arguments of the command.
        results: Function that returns the results of a folder.
        before: Arguments of a command that is run first, in an empty folder, and is not killed; none without it.
    """

    arguments: tuple[str, ...]
    results: Callable[[Path], dict[str, Any]] = _written
    before: tuple[str, ...] = ()

    def begun(self, folder: Path) -> bool:
        """Return whether a training has begun in a folder, or the continuation of one."""
        return any((folder / "run").glob("policy_*.npz" if self.before else "settings.json"))

    def continuing(self, folder: Path) -> tuple[str, ...]:
        """Return the arguments that begin the command or continue it."""
        return ("train", "--resume", "run") if self.begun(folder) else self.arguments


_CALM = json.dumps({"wind": "windy", "duration": 0.3})
_TRAINING = {
    **{"--total-timesteps": 1024, "--eval-freq": 256, "--save-freq": 256, "--num-envs": 16, "--batch-size": 32},
    **{"--net-arch": 8, "--n-eval-episodes": 2, "--scenarios": _CALM, "--out": "run"},
}
_OPTIONS = [str(part) for pair in _TRAINING.items() for part in pair]
_PPO = ("train", "--algo", "ppo", "--ppo.n-steps", "16", *_OPTIONS)
COMMANDS = {
    "train": Command(_PPO, _trained),
    "train more": Command(("train", "--resume", "run", "--more-steps", "512"), _trained, _PPO),
    "train sac": Command(("train", "--algo", "sac", "--sac.learning-starts", "64", *_OPTIONS), _trained),
    "evaluate": Command(
        ("evaluate", "flatness", "lqr", "--scenarios", f"a={_CALM}", "--episodes", "2", "--replay", "1", "--out", "out")
    ),
    "tune": Command(("tune", "lqr", "--scenarios", _CALM, "--trials", "3", "--episodes", "2", "--out", "out")),
}


def call(arguments: tuple[str, ...], folder: Path, log: Path, kill_at: int = 0, files: str = "") -> tuple[int, int]:
    """Run a command in a fork, and return its exit status (−9 if it was killed) and the number of operations."""
    reader, writer = os.pipe()
    if not (child := os.fork()):
        status = 1
        try:
            output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(output, 1)
            os.dup2(output, 2)
            os.chdir(folder)
            signal.alarm(_SECONDS)
            sys.argv = ["quadpend", "command"]  # the provenance contains it
            operations = Operations(folder, kill_at, files)
            main(list(arguments))
            status = 0
        except SystemExit as error:
            status = int(error.code or 0)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os.write(writer, str(operations.count).encode())
            os._exit(status)
    os.close(writer)
    with open(reader) as counts:
        count = int(counts.read() or 0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), count


def check(command: Command, most: int = 0, files: str = "") -> tuple[int, list[str]]:
    """Kill a command at its operations, and return how often and what was wrong.

    Args:
        command: The command.
        most: Number of operations at which it is killed, spread evenly; 0 for all.
        files: Part of the names of the files whose operations count.
    """
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        start, whole, killed, log = (Path(name, part) for part in ("start", "whole", "killed", "log"))
        start.mkdir()
        if command.before:
            status, _ = call(command.before, start, log)
            assert status == 0, log.read_text()[-3000:]
        shutil.copytree(start, whole)
        status, count = call(command.arguments, whole, log, 0, files)
        assert status == 0, log.read_text()[-3000:]
        expected = command.results(whole)
        moments = range(1, count + 1)
        chosen = [moments[(2 * i + 1) * count // (2 * most)] for i in range(most)] if most else list(moments)
        for kill_at in chosen:
            shutil.rmtree(killed, ignore_errors=True)
            shutil.copytree(start, killed)
            log.write_text("")
            first, _ = call(command.arguments, killed, log, kill_at, files)
            begun = command.begun(killed)
            changed = [] if begun or not command.before else _changed(start, killed)
            finished = begun and (killed / "run/policy.npz").exists()
            status, _ = call(command.continuing(killed), killed, log)
            fault = _fault(first, abs(status - 2) if finished else status, command, killed, expected)
            if changed or fault:
                wrong.append(f"operation {kill_at}: {fault or f'changed: {changed}'}\n{log.read_text()[-1500:]}")
    return len(chosen), wrong


def _changed(start: Path, folder: Path) -> list[str]:
    """Return which files of a finished run are not those at the start."""
    names = ("settings.json", "provenance.json", "policy.npz")
    return [name for name in names if (folder / "run" / name).read_bytes() != (start / "run" / name).read_bytes()]


def _fault(first: int, status: int, command: Command, folder: Path, expected: dict[str, Any]) -> str:
    if first != -signal.SIGKILL:
        return f"it was not killed, but ended with status {first}"
    if status:
        return f"it did not end when it was run again: status {status}"
    found = command.results(folder)
    different = [key for key in {**expected, **found} if expected.get(key) != found.get(key)]
    return f"other results: {different}" if different else ""


def _warm_up() -> None:
    """Import what the commands import, and load the kernels, so that each fork starts at once."""
    for name in ("torch.utils.tensorboard", "tyro", *(f"quadpend_train.cli.{part}" for part in _PARTS)):
        import_module(name)
    settings = replace(BRIEF, total_timesteps=16)
    validate(training.export(training.initial_model(settings, None)), settings)


def run() -> None:
    """Kill the commands, and print a line for each."""
    parser = argparse.ArgumentParser(description="Kill commands at each of their file operations.")
    parser.add_argument("commands", nargs="*", help=f"of {', '.join(COMMANDS)}; all without it")
    parser.add_argument("--most", type=int, default=0, help="operations of each command; 0 for all")
    parser.add_argument("--files", default="", help="only operations on files whose names contain this text")
    given = parser.parse_args()
    _warm_up()
    faults = Counter[str]()
    for name in given.commands or COMMANDS:
        count, wrong = check(COMMANDS[name], given.most, given.files)
        faults[name] = len(wrong)
        print(
            f"{name}: killed at {count} operations, {len(wrong)} without the results of an undisturbed run", flush=True
        )
        for line in wrong:
            print(line, flush=True)
    sys.exit(min(faults.total(), 1))


if __name__ == "__main__":
    run()
