"""Checks of folders and files to write, so that a wrong path is found before long work."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def writable_folder(path: Path, name: str = "out", files: Sequence[str] = ()) -> Path:
    """Create a folder, and check that files can be written in it.

    Args:
        path: Folder.
        name: Name of the option for error messages.
        files: Names of files that will be written, none of which may be a folder.

    Raises:
        ValueError: If the folder cannot be created or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path) as file:
            file.write(b"0")
        folders = [file for file in files if (path / file).is_dir()]
    except OSError as error:
        reason = "this is a file" if isinstance(error, FileExistsError) else error.strerror
        raise ValueError(f"{name} must be a folder that can be written, not {path}: {reason}") from error
    if folders:
        raise ValueError(f"{name} must be a folder in which {folders[0]} can be written, not {path}: this is a folder")
    return path


def writable_file(path: Path, name: str = "out") -> Path:
    """Check that a file can be written, and create its folder; the file itself does not change.

    Args:
        path: File.
        name: Name of the option for error messages.

    Raises:
        ValueError: If it is a folder, its name is too long, or its folder cannot be created or written.
    """
    try:
        is_folder = path.is_dir()
    except OSError as error:
        raise ValueError(f"{name} must be a file that can be written, not {path}: {error.strerror}") from error
    if is_folder:
        raise ValueError(f"{name} must be a file, not the folder {path}")
    writable_folder(path.parent, f"the folder of {name}")
    return path


def describe_os_error(error: OSError) -> str:
    """Return a sentence about a file that cannot be read or written, with its path if that is known."""
    if error.strerror is None:
        return str(error)
    path = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    kept = "; what was written before is kept" if error.errno in _FULL else ""
    return f"a file cannot be read or written: {path}{error.strerror}{kept}"
