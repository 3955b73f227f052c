"""Every imported package is declared in pyproject.toml, and the versions behind the results are pinned."""

import ast
import json
import re
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from quadpend_gym.core.files import read_toml
from quadpend_train.cli.main import _EXTRAS
from quadpend_train.common.provenance import versions
from tests.helpers.sources import ROOT

PROJECT = read_toml(ROOT / "pyproject.toml")["project"]
OWN = ("quadpend_gym", "quadpend_baselines", "quadpend_train", "benchmarks", "tests", "docs")
# Modules whose distribution has another name, where `packages_distributions` does not know it on every Python.
DISTRIBUTIONS = {
    "tomli": "tomli",
    "griffe": "mkdocstrings",  # griffe belongs to mkdocstrings[python]
}
# Extras that the code of a folder may import, beside the dependencies of the package.
EXTRAS = {
    "quadpend_gym": ("view",),
    "baselines": ("train", "mpc"),
    "train": ("train", "view", "onnx", "mpc", "cluster"),
    "benchmarks": ("train", "view", "dev", "cluster"),
    "tests": ("train", "view", "dev", "docs", "cluster"),
    "docs": ("train", "view", "dev", "docs", "cluster"),
}


def _name(requirement: str) -> str:
    return re.split(r"[\[<>=;! ]", requirement)[0].lower().replace("_", "-")


def _declared(folder: str) -> set[str]:
    extras = PROJECT["optional-dependencies"]
    groups = [PROJECT["dependencies"], *(extras[name] for name in EXTRAS[folder])]
    return {_name(requirement) for group in groups for requirement in group}


def _imported(file: Path) -> Iterator[str]:
    """Yield the names of the packages of others that a file imports, also inside its functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        for name in names:
            top = name.partition(".")[0]
            if top not in OWN and top not in sys.stdlib_module_names:
                yield top


@pytest.mark.parametrize("folder", EXTRAS)
def test_every_imported_package_is_declared(folder: str) -> None:
    known = packages_distributions()
    declared, undeclared = _declared(folder), set()
    for file in (ROOT / folder).rglob("*.py"):
        for module in _imported(file):
            names = [DISTRIBUTIONS[module]] if module in DISTRIBUTIONS else known.get(module, [module])
            if not declared & {_name(name) for name in names}:
                undeclared.add(f"{file.relative_to(ROOT)}: {module}")
    assert not undeclared


def test_an_undeclared_import_is_found(tmp_path: Path) -> None:
    file = tmp_path / "planted.py"
    file.write_text("import os\nfrom requests.adapters import x\nfrom . import y\nimport quadpend_gym.core\n")
    assert list(_imported(file)) == ["requests"]
    assert "requests" not in _declared("train")


def test_the_command_knows_the_extra_of_each_package() -> None:
    """So that it can say what to install if a package is missing."""
    declared = {extra: {_name(name) for name in PROJECT["optional-dependencies"][extra]} for extra in _EXTRAS}
    known = packages_distributions()
    for extra, modules in _EXTRAS.items():
        names = {_name(name) for module in modules for name in known.get(module, [module])}
        assert declared[extra] <= names, extra


def test_the_versions_that_the_results_depend_on_are_pinned() -> None:
    pins = dict(re.findall(r"^([\w-]+)==([\w.]+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    header = (ROOT / "docs/results/comparison.csv").read_text(encoding="utf-8").partition("\n")[0]
    used = json.loads(header.removeprefix("# "))["provenance"]["packages"]
    assert set(used) == set(versions())
    for name, version in used.items():
        if name != "quadpend-gym":
            assert pins[name] == version.partition("+")[0], name
