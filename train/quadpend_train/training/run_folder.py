"""The files of a run folder, and the lock that keeps a second process out of it.

``settings.json`` is written last when a run begins: a folder without it contains no run, and the same command starts
again. Every file that a resumed run reads is replaced as a whole, so that the run continues from its last checkpoint
wherever it was stopped.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from quadpend_train.common.files import UNFINISHED, write_text
from quadpend_train.common.provenance import provenance
from quadpend_train.common.version_0_1 import provenance_file
from quadpend_train.training.settings import TrainSettings
from quadpend_train.training.start import start_provenance

SETTINGS, PROVENANCE, CHECKPOINT = "settings.json", "provenance.json", "checkpoint.zip"
MODEL, POLICY, LOCK = "model.zip", "policy.npz", ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let no other process train in a folder during the block, and delete what a killed process left unfinished.

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
        for leftover in folder.glob(f"{UNFINISHED}*"):
            leftover.unlink()
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


def delete_checkpoint(folder: Path) -> None:
    """Delete what only an unfinished run needs."""
    for leftover in (folder / CHECKPOINT, *folder.glob("buffer_*.pkl")):
        leftover.unlink(missing_ok=True)
