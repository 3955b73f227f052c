"""Provenance of results: command, commit, versions and machine."""

import os
import platform
import subprocess
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

_PACKAGES = ("quadpend-gym", "gymnasium", "numpy", "scipy", "numba", "stable-baselines3", "torch")


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages that determine a result."""
    return {name: version(name) for name in _PACKAGES}


def provenance() -> dict[str, Any]:
    """Return the command line, the commit, the versions of Python and of the packages, and the machine, for JSON."""
    return {
        "command": [Path(sys.argv[0]).name.replace("__main__.py", "quadpend"), *sys.argv[1:]],
        "commit": _commit(),
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "packages": versions(),
    }


def _commit() -> str | None:
    """Return the commit of the repository that contains this package; None if it is installed, or without git."""
    root = Path(__file__).parents[3]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or None
    except OSError:  # git is not installed
        return None
