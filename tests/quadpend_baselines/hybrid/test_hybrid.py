"""Hybrids: the policy's observation, the applied action, and what the base controller's observer receives."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import observation_of
from quadpend_baselines.hybrid import (
    HYBRIDS,
    EstimateOnly,
    ResidualAction,
    hybrid_from_data,
)
from quadpend_gym import PAPER, Constant, Reference, Simulation
from quadpend_gym.actuators import ActionDelay
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.tasks.observation import as_layout
from tests.helpers.bad_input import assert_refused
from tests.helpers.controllers import HybridPolicy, constant, run_policy
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.wrappers import SHORT

SAME_STEP = {"autoreset_mode": "SameStep"}
FORCES = (0.1, -0.2, 0.1)  # N
observers = pytest.mark.parametrize("name", ["flatness", "lqi", "adrc-matched"])
feedbacks = pytest.mark.parametrize("outputs", ["full", "output_feedback"])


@observers
@feedbacks
def test_policy_observes_state_disturbance_and_with_a_residual_the_base_action(name: str, outputs: str) -> None:
    env = make_vec(5, wind="windy", observation=outputs, **SAME_STEP)
    observation, _ = env.reset(seed=0)
    policy: Any = controller(name).designed_for(Simulation(), Loop(observation=as_layout(outputs)))
    action, known = policy.predict(observation)
    state = observation_of(known.estimate, PAPER.rod_length) if policy.observer == "kalman" else observation
    disturbance = policy.estimated_disturbance(known)
    near = np.full(state.shape[1], 1.0)
    near[: state.shape[1] - 18] = 10.0
    expected: dict[Any, list[Any]] = {
        EstimateOnly: [state, disturbance],
        ResidualAction: [near * state, disturbance, 10.0 * action],
    }
    for kind, parts in expected.items():
        hybrid = kind(policy)
        seen, memory = hybrid.observe(observation, None, np.ones(5, np.bool_))
        assert seen.dtype == np.float32
        assert seen.shape == (5, hybrid.observation_size(observation.shape[1]))
        assert_allclose(seen, np.concatenate(parts, axis=1), rtol=1e-6, atol=1e-7)
        assert_array_equal(hybrid.base_action(memory)[0], action)


def test_policy_that_acts_alone_observes_the_state_in_which_its_action_acts() -> None:
    """With a known delay of two steps, the observation of two steps later."""
    env = make_vec(3, actuators=ActionDelay(2))
    hybrid = EstimateOnly("flatness").designed_for(Simulation(), Loop(delay=2))
    observation, memory, observed, true = env.reset(seed=0)[0], None, [], []
    for step in range(20):
        seen, memory = hybrid.observe(observation, memory, np.full(3, step == 0))
        observed.append(seen[:, :36])
        true.append(observation)
        action, memory = hybrid.act(*hybrid.base_action(memory))
        observation, *_ = env.step(action)
    assert_allclose(observed[10:-2], true[12:], atol=5e-3)  # the reference is continued as a polynomial
    assert np.abs(np.array(observed[10:-2]) - true[10:-2]).max() > 0.01


@observers
@feedbacks
def test_zero_residual_is_the_base_controller_alone(name: str, outputs: str) -> None:
    """Exactly, in every sub-environment, across the ends of episodes."""
    runs = []
    base = controller(name).designed_for(Simulation(), Loop(observation=as_layout(outputs)))
    for policy in (base, HybridPolicy(ResidualAction(base, 0.7), constant(0.0, 0.0, 0.0, 0.0))):
        env = make_vec(6, wind="windy", observation=outputs, **SAME_STEP, **SHORT)
        runs.append(run_policy(policy, env, 70))
    assert_same(runs[0][0], runs[1][0])
    assert_same([part[:4] for part in runs[0][1]], [part[:4] for part in runs[1][1]])
    assert np.sum([part[2] | part[3] for part in runs[0][1]]) >= 12


@observers
def test_residual_is_scaled_added_and_clipped(name: str) -> None:
    observation, _ = make_vec(4).reset(seed=0)
    base_action, _ = controller(name).predict(observation)
    for residual, scale in (((0.5, -0.5, 1.0, -1.0), 0.2), ((1.0, -1.0, 1.0, -1.0), 3.0)):
        action, memory = HybridPolicy(ResidualAction(name, scale), constant(*residual)).predict(observation)
        assert_allclose(action, np.clip(base_action + scale * np.float32(residual), -1.0, 1.0), atol=1e-6)
        command = plant_of(Simulation()).command(memory.controller.action)
        size = Simulation().command_scale
        assert_allclose(command, size * (action + np.eye(4)[0]), rtol=1e-6)


@pytest.mark.parametrize("name", ["flatness", "adrc-matched"])
def test_observer_receives_the_applied_action(name: str) -> None:
    """It finds the wind in spite of a constant residual."""
    policy: Any = controller(name)
    env = make_vec(2, wind=Constant(FORCES), max_episode_steps=None)
    hybrid_policy = HybridPolicy(ResidualAction(policy, 1.0), constant(0.02, 0.0, 0.0, 0.2))
    observation, memory = env.reset(seed=0, options={"reference": Reference.hover()})[0], None
    for _ in range(400):
        action, memory = hybrid_policy.predict(observation, memory)
        observation, *_, info = env.step(action)
    assert_allclose(policy.estimated_disturbance(memory.controller), info["disturbance"], atol=0.005)


EXAMPLES = [
    {"kind": "estimate_only", "base_controller": "lqi", "situation": False},
    {"kind": "residual_action", "base_controller": "flatness", "action_scale": 0.3},
]


@pytest.mark.parametrize("data", EXAMPLES, ids=lambda data: str(data["kind"]))
def test_hybrid_survives_plain_data_and_a_new_design_of_its_base_controller(data: dict[str, Any]) -> None:
    hybrid, slow = hybrid_from_data(data), Simulation(period=0.02)
    other = hybrid.designed_for(slow)
    assert type(hybrid) is type(other) is HYBRIDS[data["kind"]]
    assert all(getattr(hybrid, name) == value for name, value in data.items())
    assert all(getattr(other, name) == value for name, value in data.items() if name != "base_controller")
    assert (hybrid.controller.simulation, other.controller.simulation) == (Simulation(), slow)


def test_a_residual_of_version_0_3_without_fallback_is_read() -> None:
    assert hybrid_from_data({**EXAMPLES[1], "fallback_gain": 0.0}) == hybrid_from_data(EXAMPLES[1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EstimateOnly(object()), "a controller that estimates the disturbance, not <object"),
        (lambda: EstimateOnly("nix"), "no controller 'nix'"),
        (lambda: EstimateOnly("adrc-matched", True), "a Kalman observer, not 'adrc-matched'"),
        (lambda: hybrid_from_data({**EXAMPLES[1], "fallback_gain": 3.0}), "has no field 'fallback_gain'"),
        (lambda: hybrid_from_data("flatness"), "must be a mapping with a kind, .* not 'flatness'"),
        (lambda: hybrid_from_data({**EXAMPLES[1], "gain": 1.0}), "has no field 'gain'.*its fields are base_controller"),
    ],
)
def test_impossible_hybrids_are_refused(make: Any, message: str) -> None:
    assert_refused(make, message, ValueError)
