"""The structure of the code: order of imports, sizes of files and folders, and array layouts without gaps."""

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadpend_gym.core.files import read_mapping
from quadpend_gym.physics.state import STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE
from tests.helpers.sources import HEAVY, ROOT

# The packages and their subpackages, in the order of imports: each imports only from those before it. Subpackages on
# one line do not import from each other. A module beside the subpackages is treated like a subpackage.
PACKAGES = {
    "quadpend_gym": (
        ["core"],
        ["vehicles"],
        ["physics"],
        ["tasks"],
        ["wind", "sensors", "actuators", "randomization"],
        ["viewer"],
        ["envs"],
        ["wrappers"],
        ["__init__"],
    ),
    "quadpend_baselines": (
        ["gains"],
        ["policy", "modelling"],
        ["estimation"],
        ["controllers"],
        ["swing"],
        ["registry"],
        ["hybrid", "paper", "optimal"],
        ["__init__"],
    ),
    "quadpend_train": (
        ["common"],
        ["scenarios"],
        ["policies"],
        ["evaluation"],
        ["envs", "differentiable"],
        ["training"],
        ["studies"],
        ["reports"],
        ["cli"],
        ["__init__", "__main__"],
    ),
}
FOLDERS = {
    "quadpend_gym": ROOT / "quadpend_gym",
    "quadpend_baselines": ROOT / "baselines/quadpend_baselines",
    "quadpend_train": ROOT / "train/quadpend_train",
}
# (importing, imported) modules of this project where the import is inside a function, since it loads a heavy library.
LATE_IMPORTS = {
    ("quadpend_baselines.controllers.nmpc", "quadpend_baselines.controllers.nmpc_model"),  # casadi
    ("quadpend_baselines.controllers.nmpc", "quadpend_baselines.controllers.nmpc_solver"),  # casadi
    ("quadpend_gym.envs.recorder", "quadpend_gym.viewer.window"),  # pygame
    ("quadpend_gym.envs.recorder", "quadpend_gym.viewer.picture"),  # pygame
    ("quadpend_train.common.executors", "quadpend_train.common.ray_executor"),  # ray
    ("quadpend_train.common.ray_executor", "quadpend_train.common.ray_executor"),  # in a worker of Ray
    ("quadpend_train.policies.loading", "quadpend_train.policies.export"),  # torch and Stable-Baselines3
    ("quadpend_train.policies.conversion", "quadpend_train.policies.export"),  # torch and Stable-Baselines3
    ("quadpend_train.policies.conversion", "quadpend_train.policies.torch_policy"),  # torch
}
LATE_SUBPACKAGES = ["quadpend_train.cli"]  # `quadpend --help` starts without torch, matplotlib and pygame
HEAVY_LIBRARIES = HEAVY | {
    "PIL",
    "casadi",
    "fsspec",
    "imageio",
    "onnxruntime",
    "optuna",
    "ray",
    "rich",
    "sb3_contrib",
    "sympy",
    "tqdm",
}


class Import(NamedTuple):
    """An import statement: the importing module, the imported module, and whether a function contains it."""

    module: str
    imported: str
    late: bool


def source_files(package: str) -> dict[str, Path]:
    """The Python files of a package by the name of their module."""
    files = {}
    for path in sorted(FOLDERS[package].rglob("*.py")):
        parts = [package, *path.relative_to(FOLDERS[package]).with_suffix("").parts]
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


FILES = {package: source_files(package) for package in PACKAGES}
MODULES = {name: path for files in FILES.values() for name, path in files.items()}


def module_level(body: list[Any]) -> Iterator[ast.AST]:
    """The statements that Python executes when it imports a module."""
    for node in body:
        yield node
        if isinstance(node, ast.If | ast.Try):
            yield from module_level([*node.body, *node.orelse, *getattr(node, "finalbody", [])])
            yield from module_level([item for handler in getattr(node, "handlers", []) for item in handler.body])


def imports_of(module: str) -> Iterator[Import]:
    """All imports of a module, of its own packages and of others."""
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    early = set(map(id, module_level(tree.body)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import"
            full = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else str(node.module) for name in full]
        else:
            continue
        for name in names:
            yield Import(module, name, id(node) not in early)


IMPORTS = [item for module in MODULES for item in imports_of(module)]
INTERNAL = [item for item in IMPORTS if item.imported in MODULES]


def subpackage(module: str) -> tuple[int, int, str]:
    """Position of a module's package and subpackage in the order of imports, and the name of the subpackage."""
    package, _, rest = module.partition(".")
    name = rest.partition(".")[0] or "__init__"
    (level,) = [level for level, names in enumerate(PACKAGES[package]) if name in names]
    return list(PACKAGES).index(package), level, name


def test_every_module_is_in_a_known_subpackage() -> None:
    for module in MODULES:
        subpackage(module)
    for item in IMPORTS:
        assert item.imported.partition(".")[0] not in PACKAGES or item in INTERNAL, f"{item} does not exist"


def test_packages_and_subpackages_import_only_those_before_them() -> None:
    wrong = [
        f"{item.module} imports {item.imported}"
        for item in INTERNAL
        for here, there in ((subpackage(item.module), subpackage(item.imported)),)
        if here != there and (there[0] > here[0] or (there[0] == here[0] and there[1] >= here[1]))
    ]
    assert not wrong


def test_there_are_no_circular_imports() -> None:
    remaining = {module: {item.imported for item in INTERNAL if item.module == module} for module in MODULES}
    while free := [module for module, imported in remaining.items() if not imported & (remaining.keys() - {module})]:
        for module in free:
            del remaining[module]
    assert not remaining


def test_only_heavy_modules_are_imported_inside_functions() -> None:
    late = [item for item in IMPORTS if item.late and not item.module.startswith(tuple(LATE_SUBPACKAGES))]
    internal = {(item.module, item.imported) for item in late if item in INTERNAL}
    assert internal == LATE_IMPORTS
    external = {item for item in late if item not in INTERNAL}
    assert not {item for item in external if item.imported.partition(".")[0] not in HEAVY_LIBRARIES}


@pytest.mark.parametrize("package", ["quadpend_gym", "quadpend_baselines"])
def test_environments_and_baselines_never_import_torch(package: str) -> None:
    found = {item for item in IMPORTS if item.module.startswith(package)}
    assert not {item for item in found if item.imported.partition(".")[0] in {"torch", "stable_baselines3"}}


def test_only_the_viewer_imports_a_drawing_library_at_module_level() -> None:
    found = {item.module for item in IMPORTS if item.imported.partition(".")[0] in HEAVY and not item.late}
    assert all(module.startswith(("quadpend_gym.viewer.", "quadpend_train.")) for module in found)


def test_importing_the_environment_loads_no_heavy_library() -> None:
    code = "import sys, quadpend_gym, quadpend_gym.wrappers; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not HEAVY & set(ran.stdout.split())


def test_the_packages_never_import_the_benchmarks_or_the_tests() -> None:
    assert not {item for item in IMPORTS if item.imported.partition(".")[0] in {"benchmarks", "tests"}}


def test_no_file_is_longer_than_400_lines() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py", "*.html"], cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [ROOT / name for name in listed.stdout.split()]
    assert paths
    too_long = {path.name for path in paths if path.exists() and len(path.read_text().splitlines()) > 400}
    assert not too_long


def test_no_subpackage_has_more_than_twelve_files() -> None:
    sizes = Counter(path.parent for path in MODULES.values() if path.name != "__init__.py")
    assert {folder: size for folder, size in sizes.items() if size > 12} == {}


def test_only_the_three_packages_are_installed() -> None:
    found: list[str] = []
    settings = read_mapping(ROOT / "pyproject.toml")["tool"]["setuptools"]["packages"]["find"]
    for folder in settings["where"]:
        for pattern in settings["include"]:
            found += [path.name for path in (ROOT / folder).glob(pattern) if (path / "__init__.py").exists()]
    assert sorted(found) == sorted(PACKAGES)
    assert set(settings["include"]) == {f"{package}*" for package in PACKAGES}


def test_the_state_layout_has_no_gaps_and_a_view_for_each_field() -> None:
    assert [i for part in STATE_FIELDS.values() for i in range(part.start, part.stop)] == list(range(STATE_SIZE))
    numbers = np.arange(float(STATE_SIZE))
    for name, part in STATE_FIELDS.items():
        np.testing.assert_array_equal(getattr(State(numbers), name), numbers[part])


def test_the_observation_layout_has_no_gaps_and_scales_that_are_powers_of_two() -> None:
    parts = OBSERVATION_FIELDS.values()
    assert [i for part in parts for i in range(part.start, part.stop)] == list(range(OBSERVATION_SIZE))
    assert OBSERVATION_SCALE.shape == (OBSERVATION_SIZE,)
    np.testing.assert_array_equal(np.frexp(OBSERVATION_SCALE)[0], 0.5)
