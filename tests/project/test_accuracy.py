"""The measurements of docs/accuracy.md run with small numbers, and the page says what they found."""

import re

import numpy as np
import pytest

from benchmarks import accuracy
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.mujoco_engine import position_errors
from tests.helpers.physics import simulate_period
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
    assert "| mean, 1 % falls |" in coverage
    for name in accuracy.DRAWS:
        assert f"| mean, {name} |" in coverage
        assert f"| RMSE, both {name} |" in errors


@pytest.mark.parametrize("seed", [0, 1])
def test_shorter_substeps_help_where_the_rule_asks_for_them(seed: int) -> None:
    name, period = "rod of 0.1 m, bob of 0.5 kg", 0.02
    body = accuracy.BODIES[name]
    assert period / 2 > accuracy.pendulum_time(body) / 20.0  # the rule asks for more than two substeps
    run = position_errors(body, seed, accuracy.SECONDS, period, [2, 4, 20])
    assert period / 2 * run.rate > 0.1
    assert run.errors[2] > 8.0 * run.errors[4]
    assert period / 20 * run.rate < 0.1
    assert run.errors[20] < 1e-5 * body.rod_length
    assert (
        len(accuracy.rule_table({(name, period): [run]}).splitlines()) == 5
    )  # three numbers of substeps, three angles


def test_a_pendulum_that_falls_at_hover_thrust_is_not_faster_than_the_rule_says() -> None:
    p, period = accuracy.BODIES["paper"], 0.001
    states = np.zeros((1, STATE_SIZE))
    State(states).direction[:] = [np.sin(0.01), 0.0, np.cos(0.01)]
    command, rates = np.array([p.hover_thrust, 0.0, 0.0, 0.0]), []
    for _ in range(3000):
        states = simulate_period(states, command, np.zeros(DISTURBANCE_SIZE), p, period, 1)
        rates.append(float(np.linalg.norm(State(states).direction_rate)))
    assert max(rates) == pytest.approx(2.0 / accuracy.pendulum_time(p), rel=1e-3)


def test_rigid_vehicles_agree_with_mujoco_at_their_periods() -> None:
    run = accuracy.rigid_comparison(VEHICLES["hummingbird"], 0, 0.01)
    assert run.errors[20] < 1e-7 < run.errors[1]
    table = accuracy.mujoco_table({("hummingbird", 0.01): [run]})
    assert "| hummingbird | 10 ms |" in table


def test_the_page_has_small_rates_of_false_claims_about_equal_policies() -> None:
    text = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    errors = text[text.index("<!-- begin errors -->") :]
    lines = [line for line in errors.splitlines() if "both" in line or "any of" in line]  # the tests of equal policies
    rates = [float(rate) for line in lines for rate in re.findall(r"\| (\d+\.\d)", line)]
    assert len(rates) == 24
    assert max(rates) < 6.5
