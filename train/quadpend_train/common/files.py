"""Write files that are complete or unchanged, and convert results to data for JSON."""

import hashlib
import json
import math
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from quadpend_train.common import interruption
from quadpend_train.common.processes import process_is_alive

UNFINISHED = "unfinished_"  # start of the names of temporary files
_LONGEST_STEM = 40  # characters of the name of a file that are part of the name of its temporary file
_ABANDONED_SECONDS = 86400.0  # age of a temporary file of another host that is no longer written
_TEMPORARY = re.compile(rf"{UNFINISHED}(?:([A-Za-z0-9.-]+)_)?([0-9]+)(.*)", re.DOTALL)  # host, process, rest


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file in the same folder, which replaces the file when the block is complete.

    After an exception or an interruption, the old file is unchanged and there is no temporary file. The temporary file
    has the same suffix. What a killed process left of an earlier attempt is deleted, see `delete_abandoned`. A device
    such as ``/dev/stdout`` is written directly.

    Args:
        path: The file to write; its folder exists.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    if target.exists() and not target.is_file():
        yield path
        return
    rest = f"_{target.stem[:_LONGEST_STEM]}{target.suffix}"
    delete_abandoned(target.parent, rest)
    unfinished = target.with_name(temporary_name(os.getpid(), rest))
    interruption.begin_file(str(unfinished))
    try:
        yield unfinished
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
        interruption.unfinished.discard(str(unfinished))


def temporary_name(process: int, rest: str = "") -> str:
    """Return the name of a temporary file or folder of a process of this host."""
    return f"{UNFINISHED}{_host()}_{process}{rest}"


def _host() -> str:
    """Return a short name of this host: other hosts may write in the same folder."""
    return hashlib.sha256(platform.node().encode(errors="replace")).hexdigest()[:8]


def delete_abandoned(folder: Path, rest: str) -> None:
    """Delete the temporary files and folders that killed processes left in a folder.

    Those of this host are deleted if their process is not running, or if it is this process, which is not writing them.
    Those of other hosts, and those of earlier versions without the name of a host, are deleted after a day.

    Args:
        folder: The folder that contains them.
        rest: What follows the number of the process in their names.
    """
    for path in folder.glob(f"{UNFINISHED}*"):
        found = _TEMPORARY.fullmatch(path.name)
        if not found or found[3] != rest:
            continue
        if found[1] == _host():
            abandoned = int(found[2]) == os.getpid() or not process_is_alive(int(found[2]))
        else:
            abandoned = _age(path) > _ABANDONED_SECONDS
        if abandoned:
            _delete(path)


def delete_temporary(folder: Path) -> None:
    """Delete all temporary files and folders in a folder in which no other process writes."""
    for path in folder.glob(f"{UNFINISHED}*"):
        if _TEMPORARY.fullmatch(path.name):
            _delete(path)


def _age(path: Path) -> float:
    """Return the time since the last change of a file, s; 0 if another process has deleted it."""
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0


def _delete(path: Path) -> None:
    """Delete a temporary file or folder if this process is not writing it. Files of other users may stay."""
    if os.path.realpath(path) in interruption.unfinished:
        return
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def write_text(path: Path, text: str) -> None:
    """Replace a file by a text in UTF-8; after an interruption, it is complete or unchanged."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file; after an interruption, it is complete or unchanged."""
    with atomic(path) as unfinished:
        unfinished.write_bytes(data)


def toml_text(values: Mapping[str, Any]) -> str:
    """Return a mapping of numbers, texts, lists of them and such mappings as TOML, the tables after the values."""
    lines = [f"{name} = {_toml_value(value)}" for name, value in values.items() if not isinstance(value, dict)]
    for name, table in values.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


@contextmanager
def atomic_files(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder in a folder, whose files are moved to that folder when the block is complete."""
    delete_abandoned(folder, "")
    unfinished = Path(os.path.realpath(folder)) / temporary_name(os.getpid())
    interruption.begin_file(str(unfinished))
    try:
        unfinished.mkdir()
        yield unfinished
        for path in sorted(unfinished.iterdir()):
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
        interruption.unfinished.discard(str(unfinished))


def to_json_data(value: Any) -> Any:
    """Convert numbers, named tuples, mappings and lists of them to data for JSON; nan and infinity become None."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: to_json_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_data(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
