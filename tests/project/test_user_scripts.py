"""The names of a user's own files do not hide the packages of this project."""

import re
import subprocess
import sys
from pathlib import Path

from tests.helpers.sources import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = [block for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if "PPO(" in block]
BRIEF = {
    r"total_timesteps=[\d_]+": "total_timesteps=64",
    r"n_eval_episodes=\d+": "n_eval_episodes=1",
    r'"MlpPolicy", env,': '"MlpPolicy", env, n_steps=64,',
}


def run_as_train_py(code: str, folder: Path) -> None:
    """Save `code`, with fewer steps and episodes, as ``train.py`` in `folder` and run it there."""
    for long, brief in BRIEF.items():
        code = re.sub(long, brief, code)
    (folder / "train.py").write_text(code, encoding="utf-8")
    ran = subprocess.run([sys.executable, "train.py"], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_training_examples_of_the_readme_run_as_train_py(tmp_path: Path) -> None:
    assert len(EXAMPLES) == 1
    run_as_train_py("\n".join(EXAMPLES), tmp_path)


def test_ppo_script_runs_as_train_py_beside_packages_with_the_names_of_our_folders(tmp_path: Path) -> None:
    for package in ("baselines", "benchmarks", "tests"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("", encoding="utf-8")
    code = (ROOT / "train/ppo.py").read_text(encoding="utf-8")
    assert "default=3_000_000" in code
    run_as_train_py(code.replace("default=3_000_000", "default=64"), tmp_path)
