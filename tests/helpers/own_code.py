"""Modules of a user's own code, in a working directory of their own."""

import sys
from itertools import count
from pathlib import Path

import pytest

_numbers = count()


def write_module(folder: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> str:
    """Write a module into a folder, make that the working directory, and return the name of the module."""
    name = f"own_code_{next(_numbers)}"
    (folder / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    return name
