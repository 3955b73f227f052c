"""The names of a user's own files do not hide the packages of this project."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.sources import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = [
    re.sub(r"total_timesteps=[\d_]+", "total_timesteps=64", block)
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    if "PPO(" in block
]


def run_as_train_py(code: str, folder: Path) -> None:
    """Save `code` as ``train.py`` in `folder` and run it there."""
    (folder / "train.py").write_text(code, encoding="utf-8")
    ran = subprocess.run([sys.executable, "train.py"], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_the_readme_has_training_examples() -> None:
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("code", EXAMPLES)
def test_the_training_examples_of_the_readme_run_as_train_py(code: str, tmp_path: Path) -> None:
    run_as_train_py(code, tmp_path)


@pytest.mark.parametrize("package", ["baselines", "benchmarks", "tests"])
def test_the_training_examples_run_beside_a_local_package_of_that_name(package: str, tmp_path: Path) -> None:
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text("", encoding="utf-8")
    run_as_train_py("\n".join(EXAMPLES), tmp_path)


def test_a_copy_of_the_ppo_script_runs_as_train_py(tmp_path: Path) -> None:
    code = (ROOT / "train/ppo.py").read_text(encoding="utf-8")
    run_as_train_py(
        re.sub(r"default=[\d_]+, help=\"environment steps", 'default=64, help="environment steps', code), tmp_path
    )
