"""Write files that are complete or unchanged."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, with the same suffix; its file replaces `path` after the block.

    After an exception, the old file is unchanged and there is no temporary file. A device such as ``/dev/stdout`` is
    written directly.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    if target.exists() and not target.is_file():
        yield path
        return
    unfinished = target.with_name(f"unfinished_{os.getpid()}_{target.stem[:40]}{target.suffix}")
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
    """Create a folder, and check that files can be written in it, so that a wrong path is found before long work."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        raise ValueError(f"{name} must be a folder that can be written, not {path}: {error.strerror}") from error


def writable_file(path: Path, name: str = "out") -> Path:
    """Create the folder of a file, and check that files can be written in it; the file itself does not change."""
    if path.is_dir():
        raise ValueError(f"{name} must be a file, not the folder {path}")
    writable_folder(path.parent, f"the folder of {name}")
    return path
