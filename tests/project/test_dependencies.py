"""Every imported package is declared in pyproject.toml."""

import ast
import re
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from quadpend_gym.core.files import read_toml
from tests.helpers.sources import ROOT

PROJECT = read_toml(ROOT / "pyproject.toml")["project"]
OWN = ("quadpend_gym", "quadpend_baselines", "quadpend_train", "benchmarks", "experiments", "tests", "docs")
# Modules whose distribution has another name, where `packages_distributions` does not know it on every Python.
KNOWN = {**packages_distributions(), "tomli": ["tomli"], "pydantic_core": ["pydantic"]}
# Extras that the code of a folder may import, beside the dependencies of the package.
EXTRAS = {
    "quadpend_gym": ("view", "mpc", "gpu"),
    "baselines": ("train", "mpc", "control"),
    "train": ("train", "view", "mpc", "cluster", "logs", "onnx"),
    "benchmarks": ("train", "view", "dev", "peers"),
    "experiments": ("train", "view", "dev", "mpc", "peers"),
    "tests": ("train", "view", "dev", "docs", "cluster", "control"),
    "docs": ("train", "view", "dev", "docs", "cluster"),
}


def name_of(requirement: str) -> str:
    """The name of the distribution that a requirement asks for."""
    return re.split(r"[\[<>=;! ]", requirement)[0].lower().replace("_", "-")


def imported(file: Path) -> Iterator[str]:
    """Yield the names of the packages of others that a file imports, also inside its functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        yield from {name.partition(".")[0] for name in names} - {*OWN, *sys.stdlib_module_names}


@pytest.mark.parametrize("folder", EXTRAS)
def test_every_imported_package_is_declared(folder: str) -> None:
    groups = [PROJECT["dependencies"], *(PROJECT["optional-dependencies"][name] for name in EXTRAS[folder])]
    declared = {name_of(requirement) for group in groups for requirement in group}
    for file in (ROOT / folder).rglob("*.py"):
        for module in imported(file):
            assert declared & {name_of(name) for name in KNOWN.get(module, [module])}, f"{file}: {module}"
