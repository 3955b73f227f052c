"""Provenance of results: command, commit, versions and machine."""

import os
import platform
import subprocess
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

sent: dict[str, Any] = {}  # `sender` of the process that sent a call to this one, on a cluster
_PACKAGES = ("quadpend-gym", "gymnasium", "numpy", "scipy", "numba", "stable-baselines3", "torch")


def versions() -> dict[str, str]:
    """Return the versions of the packages that determine a result."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    return tuple((name, version(name)) for name in _PACKAGES)


def sender() -> dict[str, Any]:
    """Return the command line and the commit."""
    root = Path(__file__).parents[3]
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or None
    except OSError:  # git is not installed
        commit = None
    return {
        "command": [Path(sys.argv[0]).name.replace("__main__.py", "quadpend"), *sys.argv[1:]],
        "commit": commit if (root / ".git").exists() else None,
    }


def provenance() -> dict[str, Any]:
    """Return the command line, the commit, the versions of Python and of the packages, and the machine, for JSON."""
    return {
        **(sent or sender()),
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "packages": versions(),
    }
