"""Write files that are complete or unchanged, and convert results to data for JSON and TOML."""

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

UNFINISHED = "unfinished_"  # start of the names of temporary files
_LONGEST_STEM = 40  # characters of the name of a file that are part of the name of its temporary file


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, with the same suffix; its file replaces `path` after the block.

    After an exception, the old file is unchanged and there is no temporary file. A device such as ``/dev/stdout`` is
    written directly.

    Args:
        path: The file to write; its folder exists.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    if target.exists() and not target.is_file():
        yield path
        return
    unfinished = target.with_name(f"{UNFINISHED}{os.getpid()}_{target.stem[:_LONGEST_STEM]}{target.suffix}")
    try:
        yield unfinished
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace a file by a text in UTF-8; after an exception, it is unchanged."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file; after an exception, it is unchanged."""
    with atomic(path) as unfinished:
        unfinished.write_bytes(data)


def writable_folder(path: Path, name: str = "out") -> Path:
    """Create a folder, and check that files can be written in it, so that a wrong path is found before long work.

    Raises:
        ValueError: If the folder cannot be created or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        raise ValueError(f"{name} must be a folder that can be written, not {path}: {error.strerror}") from error


def writable_file(path: Path, name: str = "out") -> Path:
    """Create the folder of a file, and check that files can be written in it; the file itself does not change.

    Raises:
        ValueError: If `path` is a folder, or its folder cannot be created or written.
    """
    if path.is_dir():
        raise ValueError(f"{name} must be a file, not the folder {path}")
    writable_folder(path.parent, f"the folder of {name}")
    return path


def toml_text(values: Mapping[str, Any]) -> str:
    """Return a mapping of numbers, texts, lists of them and such mappings as TOML, the tables after the values."""
    lines = [f"{name} = {_toml_value(value)}" for name, value in values.items() if not isinstance(value, dict)]
    for name, table in values.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def to_json_data(value: Any) -> Any:
    """Convert numbers, named tuples, mappings and lists of them to data for JSON; nan and infinity become None."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: to_json_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_data(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
