"""The study of optimal flights: no worse than the first guess, resumed from its file, and a row of the leaderboard."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import find_scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation.bound import BoundEpisode, bound_row, by_scenario, read_bound, write_bound
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from tests.quadpend_train.cli.test_commands import refused

SHORT = json.dumps({"wind": "windy", "duration": 0.3})
NEEDS_CASADI = pytest.mark.skipif(find_spec("casadi") is None, reason="casadi is not installed")
EPISODE = BoundEpisode("calm", 7, True, 12.0, 1.0, 12.0, "optimum", "Solve_Succeeded", 20, 5.0, "abc")


@NEEDS_CASADI
@pytest.mark.extras
def test_the_bound_is_below_the_policies_and_its_episodes_are_planned_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    document = tmp_path / "page.md"
    document.write_text("<!-- begin bound -->\n<!-- end bound -->\n")
    settings = [f"--out={tmp_path}", f"--cache={tmp_path / 'cache'}", "--episodes=2", f"--document={document}"]
    command = ["bound", "flatness", "lqr", "--scenarios", f"short={SHORT}", *settings]
    main(command)
    episodes = read_bound(tmp_path / "bound.csv")
    assert [(item.scenario, item.seed, item.survived) for item in episodes] == [
        ("short", 3000000, True),
        ("short", 3000001, True),
    ]
    assert all(item.rmse == pytest.approx(item.planned_rmse, abs=0.01) for item in episodes)
    found = json.loads((tmp_path / "bound.json").read_text())["results"]["short"]
    assert found["flatness"]["gap"]["value"] > found["lqr"]["gap"]["value"] > 0.0
    share = 1.0 - found["lqr"]["gap"]["value"] / found["flatness"]["gap"]["value"]
    assert found["lqr"]["closed"]["value"] == pytest.approx(100.0 * share)
    assert found["lqr"]["closed"]["low"] <= 100.0 * share <= found["lqr"]["closed"]["high"]
    assert "| short | ≥ 100 |" in document.read_text()
    assert (tmp_path / "bound.png").is_file()
    settled = run_episodes([controller("flatness")], find_scenario(SHORT), 2, 3000000).settled_rmse
    assert found["flatness"]["settled_rmse"]["value"] == pytest.approx(1000.0 * settled.mean())
    assert document.read_text().count("settled (mm)") == 3  # of the clairvoyant, flatness and lqr

    from quadpend_train.studies import bound as study

    monkeypatch.setattr(study, "plan_episode", lambda task: pytest.fail("planned again"))
    before = document.read_text()
    main(command)
    assert document.read_text() == before
    with pytest.raises(pytest.fail.Exception, match="planned again"):
        main([*command, "--recompute"])
    with pytest.raises(pytest.fail.Exception, match="planned again"):  # another duration, so another episode
        main([*command[:4], f"short={json.dumps({'wind': 'windy', 'duration': 0.2})}", *settings])
    capsys.readouterr()


class FullRoll:
    """A policy that falls within 0.3 s."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        return np.array([[0.0, 1.0, 0.0, 0.0]], np.float32), state


@NEEDS_CASADI
def test_the_flight_of_the_first_guess_counts_where_the_planned_one_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    from quadpend_train.studies import bound as study

    monkeypatch.setattr(study, "track", lambda *_: FullRoll())
    scenario = find_scenario(SHORT)
    found = study.plan_episode(study.Task("short", scenario, 3))
    expected = run_episodes([controller("flatness")], scenario, 1, 3)
    assert found.source == "flatness"
    assert found.survived
    assert found.rmse == pytest.approx(1000.0 * expected.rmse[0, 0])
    assert found.settled_rmse == pytest.approx(1000.0 * expected.settled_rmse[0, 0])


@NEEDS_CASADI
def test_scenarios_whose_motion_the_planner_does_not_have_are_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    rigid, rotors = ({"simulation": {"vehicle": "hummingbird"}}, {"actuators": [{"kind": "packet_loss"}]})
    sentence = refused(["bound", "--scenarios", f"a={json.dumps(rigid)}", f"b={json.dumps(rotors)}"], capsys)
    assert "a is left out" in sentence
    assert "rigid body" in sentence
    assert "packet_loss" in sentence


def test_stored_episodes_are_a_row_of_the_leaderboard_and_missing_ones_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fall = replace(EPISODE, seed=8, survived=False, rmse=np.nan, settled_rmse=np.nan)
    path = tmp_path / "bound.csv"
    write_bound(path, [EPISODE, fall, replace(EPISODE, seed=9)])
    short = {"calm": json.dumps({"duration": 0.1})}
    comparison = compare(["flatness"], short, episodes=3, seed=7)
    row = bound_row(by_scenario(read_bound(path), ["calm"], 7, 2), comparison, "flatness")
    assert row.policy == "clairvoyant (no policy; from 2 episodes)"
    errors = 1000.0 * comparison.results["calm", "flatness"].penalised_rmse[0]
    assert row.penalised_rmse.value == pytest.approx(errors.mean() - (errors[:2].mean() - (12.0 + 1000.0) / 2))
    assert row.survival.value == 50.0

    out, seed = f"--out={tmp_path / 'out'}", "--seed=7"
    scenario = f"calm={json.dumps({'duration': 0.1})}"
    given = ["--episodes=2", "--replay=0", out, f"--cache={tmp_path / 'cache'}"]
    main(["evaluate", "flatness", "lqr", "--scenarios", scenario, seed, f"--bound={path}", *given])
    assert "clairvoyant" in capsys.readouterr().out
    sentence = refused(["evaluate", "flatness", f"--bound={path}", "--scenarios", "windy", seed], capsys)
    assert "no episode of the scenario 'windy' with the seed 7" in sentence
    assert "there is no such file" in refused(["evaluate", f"--bound={tmp_path / 'no.csv'}"], capsys)
    path.write_text("a,b\n1,2\n")
    assert "bound.csv" in refused(["evaluate", f"--bound={path}"], capsys)
