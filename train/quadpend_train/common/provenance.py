"""What a result was made with."""

import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

_PACKAGES = ("quadpend-gym", "gymnasium", "numpy", "scipy", "numba", "stable-baselines3", "torch")


def versions() -> dict[str, str]:
    """Versions of the packages that decide a result."""
    return {name: version(name) for name in _PACKAGES}


def provenance() -> dict[str, Any]:
    """What a run or a comparison was made with: package versions, commit, Python and machine."""
    root = Path(__file__).parents[3]
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or None
    except OSError:  # no git here
        commit = None
    return {
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "commit": commit if (root / ".git").exists() else None,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "packages": versions(),
    }
