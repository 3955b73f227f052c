"""The files of a run folder.

``settings.json`` is written last when a run begins, and ``policy.npz`` last when it ends. Every file that a resumed run
reads is replaced as a whole, so that the run continues from its last checkpoint wherever it was stopped.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from quadpend_train.common.files import write_text

SETTINGS, PROVENANCE, CHECKPOINT = "settings.json", "provenance.json", "checkpoint.zip"
MODEL, POLICY = "model.zip", "policy.npz"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let no other process train in a folder during the block. The operating system releases the lock of a process."""
    try:
        with FileLock(folder / ".lock", timeout=0):
            yield
    except Timeout:
        raise BlockingIOError(f"another process trains in {folder}: wait, or choose another folder") from None


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file."""
    write_text(path, json.dumps(data, indent=1) + "\n")


def read_provenance(folder: Path) -> dict[str, Any]:
    """Return the provenance of a run."""
    made: dict[str, Any] = json.loads((folder / PROVENANCE).read_text(encoding="utf-8"))
    return made


def delete_checkpoint(folder: Path) -> None:
    """Delete what only an unfinished run needs."""
    for leftover in (folder / CHECKPOINT, *folder.glob("buffer_*.pkl")):
        leftover.unlink(missing_ok=True)
