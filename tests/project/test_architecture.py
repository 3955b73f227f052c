"""The shape of the house: imports point one way, files stay small, layouts have no gaps."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.physics.state import STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE
from tests.helpers.sources import HEAVY, ROOT

FORBIDDEN = {
    "quadpend_gym": {"baselines", "train", "torch", "stable_baselines3"},
    "baselines": {"train", "torch", "stable_baselines3"},
}


def imported(nodes: Iterator[ast.AST]) -> set[str]:
    """Top-level names of the packages that import statements name."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names.add(node.module or "")
    return {name.partition(".")[0] for name in names}


def sources(package: str) -> list[Path]:
    """The Python files of a package."""
    return sorted((ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports_point_one_way(package: str) -> None:
    for path in sources(package):
        found = imported(ast.walk(ast.parse(path.read_text()))) & FORBIDDEN[package]
        assert not found, f"{path.relative_to(ROOT)} imports {found}"


def test_the_environment_imports_drawing_only_where_it_draws() -> None:
    for path in sources("quadpend_gym"):
        found = imported(iter(ast.parse(path.read_text()).body)) & HEAVY
        assert not found or path.parent.name == "viewer", f"{path.relative_to(ROOT)} imports {found} at once"


def test_importing_the_environment_loads_nothing_heavy() -> None:
    code = "import sys, quadpend_gym, quadpend_gym.wrappers; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not HEAVY & set(ran.stdout.split())


def test_no_file_is_longer_than_400_lines() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [ROOT / name for name in listed.stdout.split()]
    assert paths
    too_long = {path.name for path in paths if path.exists() and len(path.read_text().splitlines()) > 400}
    assert not too_long


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
