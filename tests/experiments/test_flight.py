"""The page of the flight benchmark counts survivors only, and draws every policy."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import flight
from quadpend_train.evaluation.envelope import Limit
from tests.helpers.policies import synthetic_comparison, synthetic_results


def test_cells_have_the_error_of_the_survivors_as_a_multiple_and_are_drawn() -> None:
    survived = np.arange(10) != 3
    errors = np.where(survived, 0.01, 1.0)
    found = synthetic_comparison(
        one=[synthetic_results(errors, survived), synthetic_results(np.full(10, 0.03))],
        two=[synthetic_results(np.full(10, 0.02)), synthetic_results(np.full(10, 0.06))],
    )
    found = replace(found, references={"s0": 0.005, "s1": 0.03})
    table = flight.cell_table(found)
    assert table["survival"].tolist() == [90.0, 100.0, 100.0, 100.0]
    assert table["error"].tolist() == pytest.approx([10.0, 30.0, 20.0, 60.0])
    assert table["multiple"].tolist() == pytest.approx([2.0, 1.0, 4.0, 2.0])
    limits = {policy: dict.fromkeys(flight.EVENTS, Limit(3.0, 2.0, np.inf)) for policy in found.policies}
    for figure in (flight.front_figure(found, flight.envelopes(limits)), flight.scenario_figure(table)):
        (legend,) = figure.legends
        assert {"one", "two"} <= {text.get_text() for text in legend.get_texts()}
