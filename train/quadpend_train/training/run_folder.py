"""The files of a run folder, and the lock that keeps a second process out of it.

``settings.json`` is written last when a run begins: a folder without it contains no run, and the same command starts
again. Every file that a resumed run reads is replaced as a whole, so that the run continues from its last checkpoint
wherever it was stopped.

When a finished run is continued, its new settings and provenance are first written to files of their own
(``continued_settings.json`` and ``continued_provenance.json``). The continuation begins when ``policy.npz`` is renamed:
a process that is killed before leaves the finished run, and one that is killed later leaves the continuation.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from quadpend_train.common.files import delete_temporary, write_text
from quadpend_train.common.provenance import provenance
from quadpend_train.common.version_0_1 import provenance_file
from quadpend_train.training.settings import TrainSettings
from quadpend_train.training.start import start_provenance

SETTINGS, PROVENANCE, CHECKPOINT = "settings.json", "provenance.json", "checkpoint.zip"
MODEL, POLICY, LOCK = "model.zip", "policy.npz", ".lock"
_CONTINUED = "continued_"  # start of the names of the new settings and provenance


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let no other process train in a folder during the block, and delete what killed processes left unfinished.

    The operating system releases the lock when the process ends, however it ends. The file of the lock stays.

    Raises:
        BlockingIOError: If another process, or another thread of this process, trains in the folder.
    """
    try:
        lock = FileLock(folder / LOCK, timeout=0).acquire()
    except Timeout:
        raise BlockingIOError(
            f"another process trains in {folder}: wait until it ends, or choose another folder"
        ) from None
    with lock:
        delete_temporary(folder)
        yield


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file."""
    write_text(path, json.dumps(data, indent=1) + "\n")


def write_provenance(folder: Path, settings: TrainSettings) -> None:
    """Write the provenance of a run."""
    write_json(folder / PROVENANCE, {**provenance(), **start_provenance(settings)})


def read_provenance(folder: Path) -> dict[str, Any]:
    """Return the provenance of a run."""
    made: dict[str, Any] = json.loads(provenance_file(folder, PROVENANCE).read_text(encoding="utf-8"))
    return made


def settings_file(folder: Path) -> Path:
    """Return the file of the settings of a run; a process killed in `begin_continuation` left them under a new name."""
    new = folder / f"{_CONTINUED}{SETTINGS}"
    return new if new.is_file() and not (folder / POLICY).is_file() else folder / SETTINGS


def begin_continuation(folder: Path, steps: int, settings: dict[str, Any]) -> None:
    """Make a finished run an unfinished one with other settings, completely or not at all.

    Args:
        folder: The folder of the run, which has a checkpoint.
        steps: Timesteps of the run so far.
        settings: The new settings.
    """
    made = read_provenance(folder)
    continued = [*(other for other in made.get("continued_at", []) if other != steps), steps]
    write_json(folder / f"{_CONTINUED}{PROVENANCE}", {**made, "continued_at": continued})
    write_json(folder / f"{_CONTINUED}{SETTINGS}", settings)
    (folder / POLICY).replace(folder / f"policy_{steps}.npz")
    complete_continuation(folder)


def complete_continuation(folder: Path) -> None:
    """Complete what a killed process left of `begin_continuation`."""
    for name in (PROVENANCE, SETTINGS):
        if (new := folder / f"{_CONTINUED}{name}").is_file():
            new.replace(folder / name)


def delete_checkpoint(folder: Path) -> None:
    """Delete what only an unfinished run needs."""
    for leftover in (folder / CHECKPOINT, *folder.glob("buffer_*.pkl"), *folder.glob(f"{_CONTINUED}*.json")):
        leftover.unlink(missing_ok=True)
