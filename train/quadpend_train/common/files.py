"""Write files that are complete or unchanged."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, with the same suffix; its file replaces `path` after the block.

    A missing folder is made. After an exception, the old file is unchanged and there is no temporary file.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_name(f"unfinished_{os.getpid()}_{target.stem[:40]}{target.suffix}")
    try:
        yield unfinished
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Replace a file by a text in UTF-8, where names of files that are not UTF-8 are escaped.

    After an exception, the file is unchanged.
    """
    with atomic(path) as unfinished:
        unfinished.write_bytes(text.encode(errors="backslashreplace"))
