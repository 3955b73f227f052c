"""Every extra can be installed into an empty environment, and its packages can be imported."""

import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from quadpend_gym.core.files import read_toml
from tests.helpers.sources import ROOT

EXTRAS = read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"]
IMPORT = """
import importlib, sys
from importlib.metadata import packages_distributions
for module, distributions in packages_distributions().items():
    named = {name.lower().replace("_", "-") for name in distributions} & {*sys.argv[1:]}
    if named and module.isidentifier() and not module.startswith("_"):
        importlib.import_module(module)
"""


def call(*command: str | Path) -> None:
    """Run a command, and show what it prints if it fails."""
    # crazyflow, of the extra `peers`, needs SCIPY_ARRAY_API before SciPy is imported.
    variables = {"SCIPY_ARRAY_API": "1", "UV_FIND_LINKS": os.environ.get("PIP_FIND_LINKS", "")}
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **variables}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.extras
@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_can_be_installed_and_imported(extra: str) -> None:
    uv = pytest.importorskip("uv").find_uv_bin()
    with TemporaryDirectory() as folder:  # up to 6 GB, which pytest would keep
        python = Path(folder, "bin/python")
        call(uv, "venv", "--python", sys.executable, folder)
        options = ["--python", python, "--constraint", "constraints.txt", "--extra", extra]
        call(uv, "pip", "install", *options, "-r", "pyproject.toml")
        names = [re.split(r"[\[<>=;! ]", requirement)[0].lower().replace("_", "-") for requirement in EXTRAS[extra]]
        call(python, "-I", "-c", IMPORT, *names)
