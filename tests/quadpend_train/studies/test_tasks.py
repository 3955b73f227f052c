"""The study of the other tasks measures settling times and tracking, and knows which references can be followed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import CONTROLLERS
from quadpend_gym.scenarios import SCENARIOS, SETS, Scenario
from quadpend_gym.tasks.feasibility import demand
from quadpend_gym.tasks.references import Reference
from quadpend_train.cli.main import main
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.settling import settling_times
from quadpend_train.policies.loading import shipped_policies
from quadpend_train.studies import tasks
from quadpend_train.studies.tasks import ACCELERATION, PARTS, feasible_shares, feedforward_command, settling


def results_with(error: list[list[float]], survived: list[bool]) -> EpisodeResults:
    """Return results of one policy with these errors, m, and otherwise without meaning."""
    nothing = np.zeros((1, len(survived)))
    steps = np.full((1, len(survived)), len(error[0]))
    return EpisodeResults(np.array([survived]), steps, *[nothing] * 6, np.array([error], np.float32))


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(results_with(error, [True, True, True, True, False]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])


@pytest.mark.parametrize("steps", [4, 11])
def test_one_small_error_at_the_end_is_not_rest(steps: int) -> None:
    """With a period of 0.03 s both episodes are shorter than the second of rest, so all errors must be small."""
    error = [[0.2] * (steps - 1) + [0.01], [0.2] * steps, [0.01] * steps]
    np.testing.assert_allclose(settling_times(results_with(error, [True] * 3), 0.03), [[np.nan, np.nan, 0.0]])


def test_episodes_that_fall_or_end_away_have_not_settled() -> None:
    error = [
        [0.1] * 200 + [0.01] * 800,
        [0.1] * 600 + [0.01] * 400,
        [0.01] * 950 + [0.1] + [0.01] * 49,
        [0.1] * 100 + [np.nan] * 900,
    ]
    found = settling(results_with(error, [True, True, True, False]), Scenario())
    assert found["settled"].value == pytest.approx(50.0)
    assert found["settled_soon"].value == pytest.approx(25.0)
    assert found["penalised_time"].value == pytest.approx((2.0 + 6.0 + 10.0 + 10.0) / 4)


def test_an_interval_of_the_penalised_time_ends_at_the_duration() -> None:
    error = [[0.01] * 1000] + [[0.1] * 1000] * 99
    time = settling(results_with(error, [True] * 100), Scenario())["penalised_time"]
    assert time.value < time.high == 10.0


def test_every_part_has_scenarios_and_policies_of_the_package() -> None:
    known = {*CONTROLLERS, *shipped_policies()}
    assert all(SCENARIOS[name] for part in PARTS.values() for name in SETS[part.scenarios])
    assert all(policy in known for part in PARTS.values() for policy in part.policies)


def test_references_are_feasible_up_to_the_acceleration_that_the_thrust_allows() -> None:
    assert feasible_shares(1.0, 20, 0) == (1.0, 1.0, 1.0)
    fast = feasible_shares(17.5, 20, 0)
    assert (fast.thrust, fast.both) == (0.0, 0.0)  # twice the hover thrust allows g √3 = 17 m/s² on a wide circle


def test_torques_limit_references_that_the_thrust_allows() -> None:
    found = feasible_shares(14.0, 50, 0)
    assert 0.0 < found.torques < found.thrust < 1.0
    assert found.both <= found.torques


def test_two_derivations_of_the_thrust_agree_on_circles() -> None:
    """Both are exact there."""
    scenario = ACCELERATION.scenario(8.0)
    circle = Reference.circle(1.5, np.sqrt(8.0 / 1.5))
    times = np.linspace(0.0, 3.0, 50)
    thrust = demand(circle, scenario.simulation.parameters, times).thrust
    np.testing.assert_allclose(feedforward_command(circle.as_array(), times, scenario)[:, 0], thrust, rtol=1e-9)


@pytest.mark.parametrize("part", ["swing-up", "agile"])
def test_a_part_writes_its_table_and_its_numbers(part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SETS, PARTS[part].scenarios, SETS[PARTS[part].scenarios][:1])
    monkeypatch.setattr(tasks, "ACCELERATION", replace(ACCELERATION, values=(1.0, 4.0)))
    document = tmp_path / "page.md"
    document.write_text(f"# Page\n\n<!-- begin tasks-{part} -->\n<!-- end tasks-{part} -->\n")
    out = tmp_path / "out"
    arguments = ["--episodes", "2", "--out", str(out), "--cache", str(tmp_path / "cache"), "--document", str(document)]
    main(["tasks", part, "flatness", *arguments])
    assert "| flatness |" in (out / f"{part}.md").read_text()
    assert (out / f"{part}.md").read_text().strip() in document.read_text()
    data = json.loads((out / f"{part}.json").read_text())
    assert set(data["results"]) == set(SETS[PARTS[part].scenarios])
    assert (out / "agile.png").exists() == (part == "agile")
    cells = [cell for policies in data["results"].values() for cell in policies.values()]
    assert all(("penalised_time" in cell) == (part == "swing-up") for cell in cells)
    if part == "agile":
        assert data["acceleration"]["feasible"] == [{"thrust": 1.0, "torques": 1.0, "both": 1.0}] * 2


def test_an_unknown_part_is_refused_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["tasks", "swingup", "flatness"])
    assert "there is no part 'swingup' (did you mean 'swing-up'?)" in capsys.readouterr().err
