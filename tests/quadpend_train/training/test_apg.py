"""Analytic policy gradients have the gradient of their cost, lower it, and refuse what they do not cover."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import CallbackList

from quadpend_baselines import controller
from quadpend_gym import OBSERVATION_FIELDS, RewardWeights
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, REFERENCE_START
from quadpend_train.training import apg as apg_module
from quadpend_train.training.algorithms import load_model, make_model
from quadpend_train.training.environment import hybrid_wrappers, make_env
from quadpend_train.training.settings import ApgSettings, HybridSettings, TrainSettings
from tests.helpers.bad_input import assert_refused
from tests.helpers.deviations import linear_feedback as deviation_gain
from tests.helpers.envs import assert_same
from tests.helpers.training import train_policy, trained_arrays

LAGGED = json.dumps({"wind": "windy", "actuators": [{"kind": "action_delay"}, {"kind": "motor_lag"}]})
CURVE = {
    "kind": "waypoints",
    "times": [0, 1.5, 3, 4.5, 6],
    "points": [[0.3, 0, 2, 0.2], [0, 0.3, 2.2], [-0.3, 0, 2, -0.2], [0, -0.3, 1.8], [0.3, 0, 2, 0.2]],
    "closed": True,
}
WITHOUT_RATES = json.dumps({"wind": "windy", "observation": "output_feedback"})
BURSTS = {"kind": "bursts", "length": [0.05, 0.05], "pause": [0.1, 0.1]}
IN_LAB = json.dumps({"base": "flight_breeze", "sensors": BURSTS, "latency": 0.01, "substeps": 1})
JUMPING = json.dumps({"task": {"trajectory": CURVE, "jumps": {"distance": [0.1, 0.1]}}})
DELAYED = json.dumps({"sensors": {"kind": "delay", "steps": 3}})
BRIEF = TrainSettings(
    algo="apg",
    scenarios=("calm", LAGGED),
    total_timesteps=16 * 30 * 10,
    num_envs=16,
    max_episode_steps=60,
    hybrid=HybridSettings("adrc-matched"),
    n_eval_episodes=1,
    apg=ApgSettings(learning_rate=2e-2, final_learning_rate=2e-2, net_arch=(8,), window=30, restart=0.0),
)


def model_and_env(settings: TrainSettings) -> Any:
    env = make_env(settings)
    return make_model(settings, env, None).learn(0), env


def cost(model: Any, env: Any) -> float:
    """Return the cost of a window from the starts of seed 0."""
    env.seed(0)
    model._last_obs = env.reset()
    model._last_episode_starts = np.ones(env.num_envs, np.bool_)
    callback = CallbackList([])
    callback.init_callback(model)
    model.collect_rollouts(env, callback, None, 1)
    return float(model._cost.detach())


def test_ten_updates_lower_the_cost() -> None:
    model, env = model_and_env(replace(BRIEF, max_episode_steps=30))
    before = cost(model, env)
    for _ in range(10):
        model.train()
        cost(model, env)
    assert cost(model, env) < 0.99 * before


def test_the_cost_of_a_step_has_the_reference_after_its_jump() -> None:
    jumps = json.dumps({"task": {"jumps": {"distance": [0.5, 0.5], "pause": [0.1, 0.1]}}})
    only = replace(BRIEF.apg, rmse=1.0, error=0.0, yaw=0.0, effort=0.0, rate=0.0, lean=0.0)
    model, env = model_and_env(replace(BRIEF, scenarios=(jumps,), hybrid=HybridSettings("flatness"), apg=only))
    errors, step = [], env.env.step

    def recorded(actions: Any) -> Any:
        result = step(actions)
        errors.append(result[4]["tracking_error"])
        return result

    env.env.step = recorded
    found = cost(model, env)
    assert found == pytest.approx(np.sqrt(np.sum(np.square(errors)) / (30 * env.num_envs) + 1e-6), rel=1e-3)


@pytest.mark.parametrize(
    ("scenario", "hybrid", "tolerance"),
    [
        ("calm", HybridSettings(), 0.0),
        (WITHOUT_RATES, HybridSettings("lqg", "memory_only"), 0.02),
        (IN_LAB, HybridSettings("lqg", "lab_only"), 0.02),
        ("calm", HybridSettings("flatness"), 0.02),
        (LAGGED, HybridSettings("flatness"), 0.02),
        (DELAYED, HybridSettings("flatness"), 0.02),
    ],
    ids=["alone", "memory", "lab", "observer", "lagged", "delayed"],
)
def test_gradient_of_the_cost_equals_a_finite_difference(
    scenario: str, hybrid: HybridSettings, tolerance: float
) -> None:
    """For the bias of each action: exactly without an observer, closely with an observer that knows the loop."""
    apg = replace(BRIEF.apg, max_state_gradient=1e9)
    settings = replace(BRIEF, scenarios=(scenario,), hybrid=hybrid, max_episode_steps=30, apg=apg)
    model, env = model_and_env(settings)
    bias = model.policy.action_net.bias
    cost(model, env)
    torch.autograd.backward(model._cost)
    found = bias.grad.numpy().copy()
    short = hybrid.mode == "lab_only"  # its linear feedback has limits, where the cost has kinks
    for i, step in enumerate((3e-4,) * 4 if short else (1e-2, 1e-2, 1e-2, 1e-1)):
        values = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                bias[i] += sign * step
            values.append(cost(model, env))
            with torch.no_grad():
                bias[i] -= sign * step
        expected = (values[0] - values[1]) / (2.0 * step)
        assert found[i] == pytest.approx(expected, rel=0.01, abs=tolerance * float(np.abs(found).max()))


def wrong_and_late(**vehicle: Any) -> dict[str, Any]:
    """Return a scenario with masses 20 % above those that the observer knows, and a latency of 1.5 periods."""
    nominal = Scenario(**vehicle).simulation.parameters
    masses = {name: [1.2 * getattr(nominal, name)] * 2 for name in ("quadrotor_mass", "bob_mass")}
    return {**vehicle, "wind": "windy", "parameters": masses, "latency": 0.015}


HUMMINGBIRD = {"vehicle": "hummingbird", "interface": "body_rates"}
DRAWN = {
    "latency": 0.02,
    "substeps": 4,
    "actuators": [{"kind": "packet_loss", "probability": 0.1}, {"kind": "gyro_bias"}],
    "loop": {"latency": [0.015, 0.025], "jitter": 0.002, "rate_loop": [0.85, 1.15], "thrust": [0.85, 1.15]},
}
WINDOWS: dict[str, dict[str, Any]] = {
    "paper": {"wind": "windy"},
    "paper, wrong and late": wrong_and_late(),
    "hummingbird, wrong and late": wrong_and_late(**HUMMINGBIRD),
    "unknown delay": {"actuators": [{"kind": "action_delay", "steps": 2}], "loop_known": False},
    "noise, no velocities": {
        "task": {"trajectory": CURVE},
        "sensors": {"kind": "noise", "position": 1e-3, "euler": 1e-3},
        "observation": "output_feedback",
    },
}
STARTS = "position", "velocity", "angle", "angle_rate", "direction", "direction_rate"
# A drawn loop, along a curve, from its beginning, without velocities
ON_CURVE = {"trajectory": CURVE, "start": dict.fromkeys(STARTS, 0.0)}
DEVIATIONS = {**HUMMINGBIRD, **DRAWN, "task": ON_CURVE, "observation": "output_feedback", "wind": "breeze"}


def linear_feedback(scenario: Scenario) -> Any:
    """Return the gain of `flatness` near hover from the estimated state in an observation to the action, (18, 4)."""
    law = controller("flatness", Scenario(vehicle=scenario.vehicle, interface=scenario.interface).simulation)
    hover, change = np.zeros(OBSERVATION_SIZE), 1e-3 * np.eye(OBSERVATION_SIZE)
    hover[OBSERVATION_FIELDS["direction"].stop - 1] = 1.0
    ends = [law.predict((hover + sign * change).astype(np.float32))[0] for sign in (1.0, -1.0)]
    return torch.as_tensor(ends[0] - ends[1])[:REFERENCE_START] / 2e-3


@pytest.mark.parametrize("name", [*WINDOWS, "hummingbird, deviations"])
def test_gradient_of_a_window_points_along_finite_differences(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """For all weights of a random network that is added to `flatness` or `lqg`, in random directions, with the observer
    in the loop.

    Small changes, since a window crosses a kink where an action or a rotor reaches its bounds, and since the feedback
    does not balance: the second derivative grows through the window.
    """
    scenario, apg = WINDOWS.get(name, DEVIATIONS), replace(BRIEF.apg, max_state_gradient=1e9, window=50)
    deviations = name not in WINDOWS
    inputs = {"deviations": deviations, "innovations": deviations}
    hybrid = HybridSettings("lqg" if deviations else "dual-mode", situation=True, **inputs)
    settings = replace(BRIEF, scenarios=(json.dumps(scenario),), hybrid=hybrid)
    model, env = model_and_env(replace(settings, num_envs=4, max_episode_steps=50, apg=apg))
    law = hybrid_wrappers(env.env)[0].hybrid.controller._law
    gain = torch.as_tensor(deviation_gain(law)).float() if deviations else linear_feedback(Scenario(**scenario))
    network = apg_module.mean_action
    monkeypatch.setattr(
        apg_module, "mean_action", lambda model, seen: network(model, seen) + seen[:, : len(gain)] @ gain
    )
    cost(model, env)
    assert model._falls == 0
    torch.autograd.backward(model._cost)
    weights = [item for item in model.policy.parameters() if item.grad is not None]
    found, expected, generator = [], [], torch.Generator().manual_seed(0)
    for _ in range(6):
        direction = [1e-5 * torch.randn(item.shape, generator=generator) for item in weights]
        found.append(sum(float((item.grad * change).sum()) for item, change in zip(weights, direction, strict=True)))
        values = []
        for step in (1.0, -2.0, 1.0):  # forwards, backwards, and back to the start
            with torch.no_grad():
                for item, change in zip(weights, direction, strict=True):
                    item += step * change
            values.append(cost(model, env))
        expected.append((values[0] - values[1]) / 2.0)
    assert np.dot(found, expected) >= 0.999 * np.linalg.norm(found) * np.linalg.norm(expected)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(expected), rel=0.01)


def test_checkpoint_has_what_training_changes_and_executes_no_code(tmp_path: Path) -> None:
    model, env = model_and_env(BRIEF)
    model.learn(2 * 16 * 30)
    model.save(tmp_path / "model.zip")
    torch.load(tmp_path / "model.zip", weights_only=True)
    assert_same(trained_arrays(load_model(BRIEF, env, tmp_path / "model.zip")), trained_arrays(model))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenarios": (json.dumps({"actuators": {"kind": "rate_limit"}}),)}, "actuator 'rate_limit', only"),
        ({"scenarios": (WITHOUT_RATES,), "hybrid": HybridSettings()}, "no velocities .* needs a base_controller"),
        ({"scenarios": (JUMPING,)}, "cannot have task.jumps with waypoints"),
        ({"reward_scale": 0.1}, "reward_scale must be 0.01 with algo 'apg', not 0.1"),
        ({"reward": RewardWeights(tip=0.1)}, "reward must be RewardWeights.* with algo 'apg', not"),
        (
            {"hybrid": HybridSettings("flatness", baseline_relative_reward=True)},
            "baseline_relative_reward must be False",
        ),
        (
            {"hybrid": HybridSettings("flatness", "residual_action")},
            "mode must be one of estimate_only, memory_only, lab_only with algo 'apg'",
        ),
    ],
    ids=str,
)
def test_what_is_not_covered_is_refused_before_training(changes: Any, message: str, tmp_path: Path) -> None:
    assert_refused(lambda: train_policy(replace(BRIEF, **changes), tmp_path / "run"), message, ValueError)
    assert not (tmp_path / "run").exists()
