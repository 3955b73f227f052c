"""What the README says can be typed, and does what it says."""

import json
import re
import shlex
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from tests.helpers.sources import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("block", re.findall(r"```python\n(.*?)```", README, re.DOTALL))
def test_python_in_the_readme_runs(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(re.sub(r"total_timesteps=[\d_]+", "total_timesteps=64", block), "README.md", "exec"), {})


def test_the_commands_in_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    train = ["--total-steps", "1024", "--num-envs", "16", "--batch-size", "256", "--evaluation-episodes", "1"]
    flown = ["--episodes", "2"]
    brief = {"train": train, "evaluate": flown, "compare": flown, "wind": ["--seconds", "1"], "card": []}
    brief["watch"] = ["--out", "look.png", "--size", "320", "240"]
    for line in "".join(blocks).splitlines():
        command, *options = shlex.split(line.removeprefix("quadpend "))
        main([command, *options, *brief[command]])
    assert (tmp_path / "results/comparison.md").exists()


def test_the_results_table_is_the_one_that_make_evidence_wrote() -> None:
    assert (ROOT / "docs/demo/comparison.md").read_text(encoding="utf-8").strip() in README


def test_the_leaderboard_is_the_one_that_make_results_wrote() -> None:
    results = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    (leaderboard,) = re.findall(r"<!-- begin leaderboard -->\n(.*?)<!-- end leaderboard -->", results, re.DOTALL)
    assert leaderboard.strip()
    assert leaderboard.strip() in README


def test_the_speed_table_is_the_one_that_make_bench_wrote() -> None:
    assert (ROOT / "docs/bench.md").read_text(encoding="utf-8").strip() in README


def test_the_data_say_how_they_were_made() -> None:
    data = json.loads((ROOT / "docs/demo/comparison.json").read_text(encoding="utf-8"))
    assert data["episodes"] >= 100
    assert {"seed", "scenarios", "results"} <= set(data)


def test_every_linked_file_exists() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
