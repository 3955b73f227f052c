"""Deviations from the reference's trajectory as inputs of a network."""

from typing import Any

import numpy as np
import pytest

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.gains import gains_for
from quadpend_baselines.hybrid import EstimateOnly
from quadpend_baselines.registry import controller_of
from quadpend_gym.core.nested import changed
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.tasks.observation import LAB
from tests.helpers.deviations import linear_feedback

SCENARIOS = find_scenarios(["flight_breeze", "flight_circle"])
SCENARIO = SCENARIOS["flight_breeze"]
# Everything is near the reference.
WIDE = {"near_error": 10.0, "far_error": 20.0, "near_tilt": 2.0, "far_tilt": 3.0}
LQG = controller_of("lqg", changed(gains_for("lqg", SCENARIO.simulation), WIDE))
HYBRID = EstimateOnly(LQG, deviations=True, innovations=True).designed_for(SCENARIO.simulation, Loop.known(SCENARIO))
GAIN = linear_feedback(HYBRID.controller._law)


def flown(scenario: str, turn: float = 0.0) -> tuple[Any, Any]:
    """Return the inputs and the actions of `lqg`, in a world that is turned about the vertical (rad)."""
    env, memory = SCENARIOS[scenario].make_vec(4), None
    observation, _ = env.reset(seed=0)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    inputs, actions = [], []
    for step in range(150):
        seen = observation.astype(np.float64)
        for name in ("position", "direction", *(f"reference_{order}" for order in range(7))):
            seen[:, LAB.columns[name]][:, :2] = seen[:, LAB.columns[name]][:, :2] @ turned
        w, x, y, z = seen[:, LAB.columns["quaternion"]].T
        c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
        seen[:, LAB.columns["quaternion"]] = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], 1)
        seen[:, LAB.columns["yaw_reference"].start] += turn
        found, memory = HYBRID.observe(seen.astype(np.float32), memory, np.full(4, step == 0))
        action, memory = HYBRID.base_action(memory)
        action, memory = HYBRID.act(action, memory)
        observation, *_ = env.step(action)
        inputs.append(found)
        actions.append(action)
    return np.array(inputs), np.array(actions)


def test_the_law_near_the_reference_is_linear_in_the_inputs() -> None:
    inputs, actions = flown("flight_breeze")
    assert inputs.shape[2] == HYBRID.observation_size(27)
    np.testing.assert_allclose(np.clip(inputs[..., : len(GAIN)] @ GAIN, -1.0, 1.0), actions, atol=2e-3)


def test_inputs_and_filtered_innovations_do_not_depend_on_the_heading() -> None:
    np.testing.assert_allclose(flown("flight_circle", 1.0)[0], flown("flight_circle")[0], atol=5e-3)


def test_only_lqg_has_them() -> None:
    with pytest.raises(ValueError, match="deviations needs the base_controller lqg, not 'lqr'"):
        EstimateOnly("lqr", deviations=True)
