"""Update generated parts of Markdown files. A pair of comments with the name of the part encloses each part."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from quadpend_train.common.files import write_text


def check(path: Path, names: Sequence[str]) -> None:
    """Check that a Markdown file has exactly one pair of comments for each generated part.

    Args:
        path: Markdown file.
        names: Names of the parts.

    Raises:
        ValueError: If the file does not exist or cannot be written, or does not contain the comments of a part exactly
            once.
    """
    if not path.is_file():
        raise ValueError(f"document must be an existing file, not {path}")
    if not os.access(path, os.W_OK):
        raise ValueError(f"document must be a file that can be written, not {path}")
    _filled(path, dict.fromkeys(names, ""))


def fill(path: Path, parts: Mapping[str, str]) -> None:
    """Replace the text between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; the rest of the file does not change.

    Args:
        path: Markdown file.
        parts: New texts by name.

    Raises:
        ValueError: If the file does not contain the comments of a part exactly once.
    """
    write_text(path, _filled(path, parts))


def _filled(path: Path, parts: Mapping[str, str]) -> str:
    """Return the text of a file with new parts."""
    text = path.read_text(encoding="utf-8")
    for name, part in parts.items():
        pattern = re.compile(rf"(<!-- begin {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)", re.DOTALL)
        text, count = pattern.subn(lambda match, part=part: f"{match[1]}\n{part.strip()}\n\n{match[2]}", text)  # type: ignore[misc]
        if count != 1:
            raise ValueError(
                f"{path} must contain <!-- begin {name} --> … <!-- end {name} --> exactly once, not {count} times"
            )
    return text
