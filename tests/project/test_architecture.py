"""The structure of the code: imports point one way, and heavy libraries load late."""

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.helpers.sources import HEAVY, ROOT

FOLDERS = {  # each package imports only from those before it
    "quadpend_gym": ROOT / "quadpend_gym",
    "quadpend_baselines": ROOT / "baselines/quadpend_baselines",
    "quadpend_train": ROOT / "train/quadpend_train",
}
PACKAGES = list(FOLDERS)


def modules() -> dict[str, Path]:
    """The files of the packages by the name of their module."""
    files = {}
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = [package, *path.relative_to(folder).with_suffix("").parts]
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


MODULES = modules()


def imports(path: Path) -> set[str]:
    """The modules that a file imports, also inside its functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in MODULES else str(node.module) for name in full}
    return names


IMPORTS = {module: imports(path) for module, path in MODULES.items()}


def package(module: str) -> str:
    """The name before the first point."""
    return module.partition(".")[0]


def room(module: str) -> str:
    """The subpackage of a module, or the module itself if it stands beside the subpackages."""
    return ".".join(module.split(".")[:2])


def test_packages_import_only_those_before_them() -> None:
    for module, names in IMPORTS.items():
        later = {*PACKAGES[PACKAGES.index(package(module)) + 1 :], "benchmarks", "experiments", "tests", "docs"}
        assert not {name for name in names if package(name) in later}, module


@pytest.mark.parametrize("part", [room, str], ids=["subpackages", "modules"])
def test_there_are_no_circular_imports(part: Callable[[str], str]) -> None:
    graph = defaultdict(set)
    for module, names in IMPORTS.items():
        graph[part(module)] |= {part(name) for name in names if name in MODULES} - {part(module)}
    assert list(TopologicalSorter(graph).static_order())


def test_environments_and_baselines_never_import_torch_except_on_a_device() -> None:
    found = {module for module, names in IMPORTS.items() if {"torch", "stable_baselines3"} & set(map(package, names))}
    on_a_device = {"quadpend_gym.device.env", "quadpend_gym.device.library"}
    assert {package(module) for module in found - on_a_device} == {"quadpend_train"}


def test_importing_the_environment_loads_no_heavy_library() -> None:
    code = "import sys, quadpend_gym, quadpend_gym.wrappers; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not HEAVY & set(ran.stdout.split())
