"""The measurements of docs/accuracy.md run with small numbers, and the page says what they found."""

import re

import pytest

from benchmarks import accuracy
from tests.helpers.sources import ROOT


def test_energy_hardly_drifts_in_an_episode() -> None:
    energy, episode, largest = accuracy.energy_drift(1000)
    assert 0.1 < energy < 10.0
    assert 0.0 < episode == largest < 1e-4


def test_the_tables_have_a_line_for_each_population(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "SIZES", (10,))
    monkeypatch.setattr(accuracy, "_interquartile_mean", lambda draw: 0.0)
    coverage = accuracy.coverage_table(trials=20, slow_trials=2)
    errors = accuracy.error_table(trials=20, families=2)
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
