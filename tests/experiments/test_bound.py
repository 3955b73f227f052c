"""The planned flights are no worse than the first guess, are planned once, and make a row of the leaderboard."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes

if find_spec("casadi") is None:
    pytest.skip("casadi is not installed", allow_module_level=True)

from experiments import bound

SHORT = Scenario(wind="windy", duration=0.3)


def test_the_bound_is_below_the_policies_and_its_episodes_are_planned_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bound.csv"
    bound.plan({"short": SHORT}, 2, 7, path, 1)
    found = bound.read(path, ["short"], 2, 7)
    flights = found["short"]
    assert flights["seed"].tolist() == [7, 8]
    np.testing.assert_allclose(flights["rmse"], flights["planned_rmse"], atol=0.01)
    comparison = compare(("flatness", "lqr"), {"short": SHORT}, 2, 7)
    table, gaps = bound.gap_table(found, comparison)
    gap = gaps["short"]
    assert gap["flatness"].value > gap["lqr"].value > 0.0
    assert f"| {100.0 * (1.0 - gap['lqr'].value / gap['flatness'].value):.1f}" in table
    assert table.splitlines()[2].startswith("| short | ≥ 100 |")
    monkeypatch.setattr(bound, "plan_episode", lambda *_: pytest.fail("planned again"))
    bound.plan({"short": SHORT}, 2, 7, path, 1)
    row = bound.bound_row(bound.read(path, ["short"], 1, 7), comparison, "flatness")
    errors = 1000.0 * comparison.table["penalised_rmse"][:2].to_numpy()
    assert row.penalised_rmse.value == pytest.approx(errors.mean() - (errors[0] - flights["rmse"].iloc[0]))
    assert row.policy == "clairvoyant (no policy; from 1 episodes)"


class FullRoll:
    """A policy that falls within 0.3 s."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> Any:
        return np.array([[0.0, 1.0, 0.0, 0.0]], np.float32), state


def test_the_flight_of_the_first_guess_counts_where_the_planned_one_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bound, "track", lambda *_: FullRoll())
    found = bound.plan_episode("short", SHORT, 3)
    expected = run_episodes([controller("flatness")], SHORT, 1, 3)
    assert (found["source"], found["survived"]) == ("flatness", 1)
    assert found["rmse"] == pytest.approx(1000.0 * expected.rmse[0, 0])
    assert found["settled_rmse"] == pytest.approx(1000.0 * expected.settled_rmse[0, 0])
