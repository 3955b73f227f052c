"""Read TOML and JSON files, write files that are complete or unchanged, and convert results to data for JSON."""

import json
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from quadpend_gym.core.toml import read_toml
from quadpend_train.common import interruption

UNFINISHED = "unfinished_"  # start of the names of temporary files
_LONGEST_STEM = 40  # characters of the name of a file that are part of the name of its temporary file


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the mapping in a file: JSON if its name ends with ``.json``, else TOML.

    Raises:
        ValueError: If the file is not valid or does not contain a mapping.
    """
    if path.suffix != ".json":
        return read_toml(path)
    try:
        return parse_mapping(path.read_text(encoding="utf-8"), str(path))
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not valid JSON: {error}") from error


def parse_mapping(text: str, name: str) -> dict[str, Any]:
    """Return the mapping in a JSON text.

    Args:
        text: JSON text.
        name: Name of the text for error messages.

    Raises:
        ValueError: If the text is not valid or does not contain a mapping.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{name} is not valid JSON: {error}") from error
    except RecursionError as error:
        raise ValueError(f"{name} is nested too deeply") from error
    if not isinstance(value, dict):
        raise ValueError(f"{name} must contain a mapping, not {value!r}")
    return value


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file in the same folder, which replaces the file when the block is complete.

    After an exception or an interruption, the old file is unchanged and there is no temporary file. The temporary file
    has the same suffix. What a killed process left of an earlier attempt is deleted. A device such as
    ``/dev/stdout`` is written directly.

    Args:
        path: The file to write; its folder exists.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    if target.exists() and not target.is_file():
        yield path
        return
    rest = f"_{target.stem[:_LONGEST_STEM]}{target.suffix}"
    _delete_abandoned(target.parent, rest)
    unfinished = target.with_name(f"{UNFINISHED}{os.getpid()}{rest}")
    interruption.begin_file(str(unfinished))
    try:
        yield unfinished
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
        interruption.unfinished.discard(str(unfinished))


def _delete_abandoned(folder: Path, rest: str) -> None:
    """Delete the temporary files or folders that end with `rest` and whose process was killed."""
    if os.name != "posix":  # elsewhere there is no safe way to ask for a process
        return
    for path in folder.glob(f"{UNFINISHED}*"):
        process = path.name.removeprefix(UNFINISHED).removesuffix(rest)
        if path.name.endswith(rest) and process.isdecimal():
            with suppress(PermissionError):  # the process of another user
                try:
                    os.kill(int(process), 0)
                except (ProcessLookupError, OverflowError):
                    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace a file by a text in UTF-8; after an interruption, it is complete or unchanged."""
    with atomic(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


@contextmanager
def atomic_files(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder in a folder, whose files are moved to that folder when the block is complete."""
    _delete_abandoned(folder, "")
    unfinished = folder / f"{UNFINISHED}{os.getpid()}"
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
