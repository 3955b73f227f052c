"""The code on every page of the documentation runs, its commands are valid, and its tables equal the code."""

import ast
import functools
import importlib.util
import json
import re
import shlex
import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import tyro

from docs.tools import ranges, vehicles
from docs.tools.settings import tables
from quadpend_gym import OBSERVATION_FIELDS, Limits, RewardWeights, Simulation, StartSettings
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.observation import OBSERVATION_SCALE
from quadpend_gym.vehicles import Drag, Pole, RateLoop, Rotors, Vehicle
from quadpend_train.cli.main import main
from tests.helpers.envs import IDS
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TASKS = (ROOT / "docs/tasks.md").read_text(encoding="utf-8")
# Libraries of `docs/use-with.md` that the extras do not install, and a module that only the full installation has
OPTIONAL = {"minari": "h5py", "ray": "ray.rllib"}
BRIEF = {
    r"total_timesteps=[\d_]+": "total_timesteps=64",
    r"learning_starts=[\d_]+": "learning_starts=32",
    r"n_eval_episodes=\d+": "n_eval_episodes=1",
    r'"MlpPolicy", env,': '"MlpPolicy", env, n_steps=64,',
    r"num_envs, num_steps, updates = [^#]*": "num_envs, num_steps, updates = 64, 8, 2  ",
    r"episodes=\d+": "episodes=2",
    r"duration=4\.0": "duration=0.5",
    r"range\(200\)": "range(20)",
    r"video_length=200": "video_length=20",
}


def blocks(language: str) -> list[Any]:
    """All blocks of code in a language, with the name of the page and the number of the block."""
    return [
        pytest.param(block, id=f"{page.stem}-{number}")
        for page in PAGES
        for number, block in enumerate(re.findall(rf"```{language}\n(.*?)```", page.read_text("utf-8"), re.DOTALL))
    ]


def write_files(folder: Path) -> None:
    """Write the TOML files that the pages show."""
    for page in PAGES:
        for text, name in re.findall(r"```toml\n(# (\w+\.toml).*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            (folder / name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize("block", blocks("python"))
def test_python_on_every_page_runs(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(block))
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [])
    }
    for package in imported & set(OPTIONAL):
        if importlib.util.find_spec(package) is None or importlib.util.find_spec(OPTIONAL[package]) is None:
            pytest.skip(f"{package} is not installed")
    for long, brief in BRIEF.items():
        block = re.sub(long, brief, block)
    monkeypatch.chdir(tmp_path)
    shorten_scenarios(monkeypatch, 1.0)
    for name in IDS:
        monkeypatch.setattr(gym.spec(name), "max_episode_steps", 100)
    write_files(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    exec(compile(block, "page.md", "exec"), {"__name__": "__main__"})


def parse_only(command: Any) -> Any:
    """A function with the options of `command` that does nothing."""
    if isinstance(command, functools.partial):
        return functools.partial(parse_only(command.func), *command.args, **command.keywords)
    return functools.wraps(command)(lambda *args, **kwargs: None)


@pytest.mark.parametrize("block", blocks("sh"))
def test_commands_on_every_page_are_valid(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parse = tyro.cli
    monkeypatch.setattr(tyro, "cli", lambda command, **options: parse(parse_only(command), **options))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs/mine").mkdir(parents=True)
    (tmp_path / "runs/mine/settings.json").write_text("{}", encoding="utf-8")
    shutil.copytree(ROOT / "docs/examples", tmp_path, dirs_exist_ok=True)
    monkeypatch.syspath_prepend(tmp_path)
    write_files(tmp_path)
    for line in re.sub(r"\\\n", "", block).splitlines():
        if line.startswith("quadpend "):
            main(shlex.split(line, comments=True)[1:])


def rows(text: str, columns: int) -> list[list[str]]:
    """The cells of all table rows of a page that have this number of columns."""
    lines = re.findall(r"^\| (.*) \|$", text, re.MULTILINE)
    return [cells for line in lines if len(cells := re.split(r" \| ", line)) == columns]


def test_the_table_of_the_observation_equals_its_layout() -> None:
    table = {row[1].strip("`"): row for row in rows(TASKS, 5) if "–" in row[0]}
    assert list(table) == list(OBSERVATION_FIELDS)
    for name, columns in OBSERVATION_FIELDS.items():
        assert table[name][0] == f"{columns.start}–{columns.stop - 1}"
        scales = [float(scale) for scale in table[name][4].split(",")]
        assert (OBSERVATION_SCALE[columns] == scales).all()


def test_the_table_of_the_state_equals_its_layout() -> None:
    page = (ROOT / "docs/frames.md").read_text(encoding="utf-8")
    table = {row[1].strip("`"): row[0] for row in rows(page, 5) if "–" in row[0]}
    assert table == {name: f"{part.start}–{part.stop - 1}" for name, part in STATE_FIELDS.items()}


def test_the_numbers_of_the_task_equal_those_of_the_code() -> None:
    weights = {row[0].strip("`"): float(row[2]) for row in rows(TASKS, 3) if re.fullmatch(r"0\.\d+", row[2])}
    default = RewardWeights()
    assert weights == {name: getattr(default, name) for name in ("tracking", "upright", "yaw", "effort")}
    deviations = [float(row[1].split()[0]) for row in rows(TASKS, 2) if re.match(r"0\.\d+", row[1])]
    assert deviations == [value for value in vars(StartSettings()).values() if isinstance(value, float)]
    scale = Simulation().command_scale
    for number in (f"u = {scale[0]:g} N", f"= {scale[1]:g} N·m · a₁", f"= {scale[3]:g} N·m · a₃"):
        assert number in TASKS
    assert f"more than {Limits().pendulum_angle * 57.2958:.0f}°" in TASKS
    assert f"more than {Limits().body_angle * 57.2958:.0f}°" in TASKS
    assert f"exceeds {Limits().tracking_error:g} m" in TASKS


def test_the_tables_of_settings_and_presets_are_generated_from_the_code() -> None:
    page = (ROOT / "docs/training.md").read_text(encoding="utf-8")
    missing = [name for name, table in tables().items() if f"<!-- begin {name} -->\n\n{table}\n\n" not in page]
    assert missing == [], "run python -m docs.tools.settings"


def test_the_page_of_ranges_has_the_ranges_of_the_code() -> None:
    page = ranges.PAGE.read_text(encoding="utf-8")
    missing = [name for name, table in ranges.tables().items() if f"<!-- begin {name} -->\n\n{table}\n\n" not in page]
    assert missing == [], "run python -m docs.tools.ranges"


def test_the_page_of_vehicles_has_the_presets_the_fields_and_the_picture_of_the_code() -> None:
    page = vehicles.PAGE.read_text(encoding="utf-8")
    missing = [name for name, table in vehicles.tables().items() if f"<!-- begin {name} -->\n\n{table}\n\n" not in page]
    assert missing == [], "run python -m docs.tools.vehicles"
    assert vehicles.PICTURE.read_text(encoding="utf-8") == vehicles.picture(), "run python -m docs.tools.vehicles"
    named = {field.name for kind in (Vehicle, Pole, Rotors, Drag, RateLoop) for field in fields(kind)}
    assert {name for name in named if f"`{name}`" not in page} == set()


def test_the_rate_on_the_page_of_training_is_that_of_time_to_beat() -> None:
    measured = json.loads((ROOT / "docs/time_to_beat.json").read_text(encoding="utf-8"))["steps_per_second"]
    page = (ROOT / "docs/training.md").read_text(encoding="utf-8")
    assert f"make {measured / 1000:.0f} k timesteps per second" in page
    assert f"about {7_000_000 / measured:.0f} s" in page
