"""The hidden vehicles of `experiments.hidden_vehicles`."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments import hidden_vehicles
from experiments.hidden_vehicles import CURVE, LATENCY, START, Loop, flown_log, hidden_loop
from experiments.simulated_logs import manoeuvre


def test_a_throttle_makes_its_thrust() -> None:
    loop = hidden_loop(3)
    for voltage in (3.4, 4.0):
        assert_allclose(loop.thrust(loop.throttle(1.5, voltage), voltage), 1.5)


def test_the_controller_of_the_start_flies_a_hidden_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden_vehicles, "DURATION", 3.0)
    table = flown_log(hidden_loop(3), Loop(START, LATENCY, CURVE), 3)
    wanted = np.array([manoeuvre(time)[0] for time in table.time])
    assert np.abs(table[["x", "y", "z"]].to_numpy() - wanted).max() < 1.0
    assert table[["motor1", "motor2", "motor3", "motor4"]].to_numpy().max() < 1.0
