"""The commands in the README and the quickstart run, and the published tables equal the generated files."""

import json
import re
import shlex
from pathlib import Path

import pytest

import quadpend_gym
from quadpend_train.cli.main import main
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
QUICKSTART = (ROOT / "docs/quickstart.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs/results.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", [README, QUICKSTART], ids=["README", "quickstart"])
def test_the_commands_in_the_readme_and_the_quickstart_run(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shorten_scenarios(monkeypatch, 1.0)
    train = ["--total-timesteps", "1024", "--num-envs", "16", "--batch-size", "64", "--n-eval-episodes", "1"]
    evaluate = ["--episodes", "2"]
    brief = {"train": train, "evaluate": evaluate, "compare": evaluate, "wind": ["--seconds", "1"], "card": []}
    brief["watch"] = ["--out", "look.png", "--size", "320", "240"]
    for block, name in re.findall(r"```toml\n(# (\w+\.toml).*?)```", text, re.DOTALL):
        (tmp_path / name).write_text(block, encoding="utf-8")
    for line in "".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL)).splitlines():
        command, *options = shlex.split(line.removeprefix("quadpend "))
        if command != "tune":  # takes minutes; `test_pages` checks its options
            main([command, *options, *brief[command]])
    assert (tmp_path / "results/comparison.md").exists()


def test_the_readme_has_at_most_160_lines() -> None:
    assert len(README.splitlines()) <= 160
    assert len(README.split()) <= 1500


def test_the_citation_has_the_version_of_the_package() -> None:
    assert f"\nversion: {quadpend_gym.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_table_of_a_minute_of_training_equals_the_file_of_make_evidence() -> None:
    assert (ROOT / "docs/demo/comparison.md").read_text(encoding="utf-8").strip() in RESULTS


def test_the_leaderboard_of_the_readme_equals_that_of_the_results_page() -> None:
    (leaderboard,) = re.findall(r"<!-- begin leaderboard -->\n(.*?)<!-- end leaderboard -->", RESULTS, re.DOTALL)
    assert leaderboard.strip()
    assert leaderboard.strip() in README


def test_the_speed_table_equals_the_file_of_make_bench() -> None:
    page = (ROOT / "docs/benchmarks.md").read_text(encoding="utf-8")
    assert (ROOT / "docs/bench.md").read_text(encoding="utf-8").strip() in page


def test_result_data_contain_episodes_seed_and_scenarios() -> None:
    data = json.loads((ROOT / "docs/demo/comparison.json").read_text(encoding="utf-8"))
    assert data["episodes"] >= 100
    assert {"seed", "scenarios", "results"} <= set(data)
