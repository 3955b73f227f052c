"""Flights that iterative LQR improves are flights of the environment, for both vehicles and drawn loops."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import controller
from quadpend_gym import Scenario

pytest.importorskip("casadi", reason="casadi is not installed: pip install 'quadpend-gym[mpc]'")
from quadpend_baselines.planning.ilqr import improve_flight

AT_REST = dict.fromkeys(("position", "velocity", "angle", "angle_rate", "direction", "direction_rate"), 0.0)
HUMMINGBIRD = {"vehicle": "hummingbird", "interface": "body_rates", "latency": 0.015, "wind_rise": 0.2}


@pytest.mark.parametrize("parts", [{}, HUMMINGBIRD, {**HUMMINGBIRD, "loop": {"latency": [0.01, 0.02]}}])
def test_an_improved_flight_has_half_the_error_and_is_flown_by_the_environment(parts: Any) -> None:
    scenario = Scenario(task={"start": AT_REST}, wind="windy", duration=1.0, unscored=0.4, **parts)
    found = improve_flight(controller("flatness"), scenario, seed=3, iterations=6)
    env = scenario.make_vec(1, AutoresetMode.DISABLED)
    observation, _ = env.reset(seed=[3])
    policy, memory, errors = controller("flatness").adapt(scenario), None, []
    for step in range(scenario.steps):
        action, memory = policy.predict(observation, memory, np.array([step == 0]))
        observation, *_, info = env.step(action)
        errors.append(np.linalg.norm(info["tracking_error"][0]))
    env.reset(seed=[3])
    again = []
    for step in range(scenario.steps):
        *_, info = env.step(found.actions[step : step + 1].astype(np.float32))
        again.append(info["tracking_error"][0])
    np.testing.assert_allclose(again, found.errors, rtol=1e-6, atol=1e-9)
    scored = slice(round(0.4 / scenario.period), None)
    rmse = np.sqrt(np.mean(np.square(errors)[scored]))
    assert np.sqrt(np.mean(np.sum(np.square(again), axis=1)[scored])) < 0.5 * rmse
