"""The measurements of docs/accuracy.md run with small numbers, and the page says what they found."""

import re

import pytest

from benchmarks import accuracy
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.mujoco_engine import position_errors
from tests.helpers.sources import ROOT


def test_energy_hardly_drifts_in_an_episode() -> None:
    energy, episode, largest = accuracy.energy_drift(1000)
    assert 0.1 < energy < 10.0
    assert 0.0 < episode == largest < 1e-4


def test_shorter_substeps_help_where_the_rule_asks_for_them() -> None:
    name, period = "rod of 0.1 m, bob of 0.5 kg", 0.02
    body = accuracy.BODIES[name]
    assert period / 2 > accuracy.pendulum_time(body) / 20.0  # the rule asks for more than two substeps
    run = position_errors(body, 0, accuracy.SECONDS, period, [2, 4, 20])
    assert run.errors[2] > 8.0 * run.errors[4]
    assert run.errors[20] < 1e-5 * body.rod_length
    assert "error with h" in accuracy.rule_table({(name, period): [run]})


def test_rigid_vehicles_agree_with_mujoco_at_their_periods() -> None:
    run = accuracy.rigid_comparison(VEHICLES["hummingbird"], 0, 0.01)
    assert run.errors[20] < 1e-7 < run.errors[1]
    assert "| hummingbird | 10 ms |" in accuracy.mujoco_table({("hummingbird", 0.01): [run]})


def test_the_tables_have_a_line_for_each_population(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "SIZES", (10,))
    monkeypatch.setattr(accuracy, "_interquartile_mean", lambda draw: 0.0)
    coverage, errors = accuracy.coverage_table(trials=20, slow_trials=2), accuracy.error_table(trials=20, families=2)
    for name in accuracy.DRAWS:
        assert f"| mean, {name} |" in coverage
        assert f"| RMSE, both {name} |" in errors


def test_the_page_has_small_rates_of_false_claims_about_equal_policies() -> None:
    text = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    errors = text[text.index("<!-- begin errors -->") :]
    lines = [line for line in errors.splitlines() if "both" in line or "any of" in line]  # the tests of equal policies
    rates = [float(rate) for line in lines for rate in re.findall(r"\| (\d+\.\d)", line)]
    assert len(rates) == 24
    assert max(rates) < 6.5
