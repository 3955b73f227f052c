"""Every scenario of the flight benchmark has a reference, its own where the linear model holds."""

from dataclasses import replace

import pytest

from quadpend_baselines.modelling.linear_reference import linear_reference
from quadpend_gym.scenarios import SCENARIOS, SETS
from quadpend_train.evaluation.linear_models import reference, references

OWN = (
    *("flight_breeze", "flight_windy", "flight_dryden_slow", "flight_dryden_medium", "flight_dryden_fast"),
    *("flight_late_known", "flight_noisy"),
)


def test_hover_in_gaussian_wind_with_a_known_loop_has_its_own_reference() -> None:
    scenarios = {name: SCENARIOS[name] for name in SETS["flight"]}
    assert tuple(name for name, scenario in scenarios.items() if reference(scenario)[1]) == OWN
    found = references(scenarios)
    breeze = found["flight_breeze"]
    assert found["flight_circle"] == found["flight_late"] == found["flight_losses"] == breeze
    assert found["flight_gusts"] == pytest.approx(breeze, rel=0.01)
    assert found["flight_noisy"] > 2.0 * breeze


def test_biases_are_left_out() -> None:
    white = replace(
        SCENARIOS["flight_breeze"], sensors={"kind": "noise", "position": 0.0005, "euler": 0.001, "direction": 0.0006}
    )
    unbiased = replace(white, actuators=(), wind_rise=0.0)
    assert references({"breeze": SCENARIOS["flight_breeze"]})["breeze"] == linear_reference(unbiased)
    with pytest.raises(ValueError, match="biases"):
        linear_reference(replace(SCENARIOS["flight_breeze"], wind_rise=0.0, actuators=()))
    with pytest.raises(ValueError, match="unknown loop"):
        linear_reference(replace(unbiased, loop=SCENARIOS["flight_late"].loop))
