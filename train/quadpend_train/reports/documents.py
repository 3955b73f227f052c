"""Generated parts of documents, between a pair of comments with a name."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path


def check(path: Path, names: Sequence[str]) -> None:
    """Raise ValueError if a document has not one place for each part."""
    if not path.is_file():
        raise ValueError(f"there is no document {path}")
    fill(path, dict.fromkeys(names, ""), write=False)


def fill(path: Path, parts: Mapping[str, str], *, write: bool = True) -> None:
    """Put new text between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; what is around it stays.

    Args:
        path: of a document that has both comments of every part, once.
        parts: by name.
        write: whether to change the file.

    Raises:
        ValueError: a part has no place, or more than one.
    """
    text = path.read_text(encoding="utf-8")
    for name, part in parts.items():
        place = re.compile(rf"(<!-- begin {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)", re.DOTALL)
        text, count = place.subn(lambda match, part=part: f"{match[1]}\n{part.strip()}\n\n{match[2]}", text)  # type: ignore[misc]
        if count != 1:
            raise ValueError(f"{path} must have one place for {name!r}, not {count}: <!-- begin {name} -->, then end")
    if write:
        path.write_text(text, encoding="utf-8")
