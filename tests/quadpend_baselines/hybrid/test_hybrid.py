"""Hybrids: the policy's observation, the applied action, and what the base controller's observer receives."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.gains import GAINS
from quadpend_baselines.hybrid import (
    HYBRIDS,
    BandwidthScheduling,
    EstimateOnly,
    Hybrid,
    ResidualAction,
    hybrid_from_data,
)
from quadpend_baselines.policy.protocol import to_command
from quadpend_gym import Constant, Parameters, Reference, Simulation
from quadpend_gym.actuators import ActionDelay
from quadpend_gym.wrappers import VectorActuatorWrapper, VectorOutputFeedbackWrapper
from tests.helpers.bad_input import assert_refused
from tests.helpers.controllers import AVAILABLE_CONTROLLERS, HybridPolicy, constant, run_policy, zero_action
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.wrappers import SHORT

SAME_STEP = {"autoreset_mode": "SameStep"}
FORCES = (0.1, -0.2, 0.1)  # N
observers = pytest.mark.parametrize("name", ["flatness", "lqi", "adrc-matched"])
feedbacks = pytest.mark.parametrize("outputs", [False, True], ids=["whole", "outputs"])


@observers
@feedbacks
def test_policy_observes_state_disturbance_and_with_a_residual_the_base_action(name: str, outputs: bool) -> None:
    env: Any = make_vec(5, wind="windy", **SAME_STEP)
    env = VectorOutputFeedbackWrapper(env) if outputs else env
    observation, _ = env.reset(seed=0)
    policy: Any = controller(name)
    action, known = policy.predict(observation)
    estimates_state = isinstance(policy, OutputFeedback)
    state = policy.estimated_observation(observation, known) if estimates_state else observation
    disturbance = policy.estimated_disturbance(known)
    near = np.full(state.shape[1], 1.0)
    near[: state.shape[1] - 18] = 10.0
    expected: dict[Any, list[Any]] = {
        EstimateOnly: [state, disturbance],
        ResidualAction: [near * state, disturbance, 10.0 * action],
    }
    if name == "flatness":
        expected[BandwidthScheduling] = [near * state, disturbance]
    for kind, parts in expected.items():
        hybrid = kind(policy)
        seen, memory = hybrid.observe(observation, None, np.ones(5, np.bool_))
        assert seen.dtype == np.float32
        assert seen.shape == (5, hybrid.observation_size(observation.shape[1]))
        assert_allclose(seen, np.concatenate(parts, axis=1), rtol=1e-6, atol=1e-7)
        if kind is not BandwidthScheduling:
            assert_array_equal(hybrid.base_action(memory)[0], action)


def test_policy_that_acts_alone_observes_the_state_in_which_its_action_acts() -> None:
    """With a known delay of two steps, the observation of two steps later."""
    env = VectorActuatorWrapper(make_vec(3), ActionDelay(2))
    hybrid = EstimateOnly("flatness").with_simulation(Simulation(), Loop(delay=2))
    observation, memory, observed, true = env.reset(seed=0)[0], None, [], []
    for step in range(20):
        seen, memory = hybrid.observe(observation, memory, np.full(3, step == 0))
        observed.append(seen[:, :36])
        true.append(observation)
        action, memory = hybrid.act(*hybrid.base_action(memory))
        observation, *_ = env.step(action)
    assert_allclose(observed[10:-2], true[12:], atol=5e-3)  # the reference is continued as a polynomial
    assert np.abs(np.array(observed[10:-2]) - true[10:-2]).max() > 0.01


def test_observed_disturbance_is_that_of_the_info() -> None:
    # A lasting vertical force is attributed to the mass, so there is none.
    env = make_vec(3, wind=Constant((*FORCES[:2], 0.0), torque=0.02), max_episode_steps=None)
    policy = HybridPolicy(EstimateOnly("flatness"), lambda seen: action)
    action = np.zeros((3, 4), np.float32)
    base_controller, observation, memories = controller("flatness"), env.reset(seed=0)[0], [None, None]
    for _ in range(300):
        action, memories[0] = base_controller.predict(observation, memories[0])
        applied, memories[1] = policy.predict(observation, memories[1])
        assert_array_equal(applied, action)
        observation, *_, info = env.step(applied)
    assert_allclose(policy.seen[-1][:, 36:], info["disturbance"], atol=1e-3)


@observers
@feedbacks
def test_zero_residual_is_the_base_controller_alone(name: str, outputs: bool) -> None:
    """Exactly, in every sub-environment, across the ends of episodes."""
    runs = []
    for policy in (controller(name), HybridPolicy(ResidualAction(name, 0.7))):
        env: Any = make_vec(6, wind="windy", **SAME_STEP, **SHORT)
        runs.append(run_policy(policy, VectorOutputFeedbackWrapper(env) if outputs else env, 70))
    assert_same(runs[0][0], runs[1][0])
    assert_same([part[:4] for part in runs[0][1]], [part[:4] for part in runs[1][1]])
    assert np.sum([part[2] | part[3] for part in runs[0][1]]) >= 12


def test_zero_action_keeps_the_nominal_bandwidths() -> None:
    runs = [
        run_policy(policy, make_vec(6, wind="windy", **SAME_STEP, **SHORT), 70)
        for policy in (controller("flatness"), HybridPolicy(BandwidthScheduling("flatness", 2.0)))
    ]
    assert_allclose(runs[1][0], runs[0][0], atol=1e-12)
    assert_array_equal([part[0] for part in runs[1][1]], [part[0] for part in runs[0][1]])


@observers
def test_residual_is_scaled_added_and_clipped(name: str) -> None:
    observation, _ = make_vec(4).reset(seed=0)
    base_action, _ = controller(name).predict(observation)
    for residual, scale in (((0.5, -0.5, 1.0, -1.0), 0.2), ((1.0, -1.0, 1.0, -1.0), 3.0)):
        action, memory = HybridPolicy(ResidualAction(name, scale), constant(*residual)).predict(observation)
        assert_allclose(action, np.clip(base_action + scale * np.float32(residual), -1.0, 1.0), atol=1e-6)
        known = memory.controller
        command = to_command(known.action, Simulation()) if hasattr(known, "action") else known.command
        size = Simulation().command_scale
        assert_allclose(command, size * (action + np.eye(4)[0]), rtol=1e-6)


@pytest.mark.parametrize("reported", [True, False])
@pytest.mark.parametrize("name", ["flatness", "adrc-matched"])
def test_observer_receives_the_applied_action(name: str, reported: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """It finds the wind in spite of a constant residual; without the report it attributes the residual to wind."""
    policy: Any = controller(name)
    if not reported:
        monkeypatch.setattr(policy, "with_applied_action", lambda memory, action: memory)
    env = make_vec(2, wind=Constant(FORCES), max_episode_steps=None)
    hybrid_policy = HybridPolicy(ResidualAction(policy, 1.0), constant(0.02, 0.0, 0.0, 0.2))
    observation, memory = env.reset(seed=0, options={"reference": Reference.hover()})[0], None
    for _ in range(400):
        action, memory = hybrid_policy.predict(observation, memory)
        observation, *_, info = env.step(action)
    error = np.abs(policy.estimated_disturbance(memory.controller) - info["disturbance"])
    if reported:
        assert error.max() < 0.005
    else:
        assert (error[:, 2] > 0.1).all()  # 0.02 of 6.86 N
        assert (error[:, 8] > 0.1).all()  # 0.2 of 1 N·m


def test_observer_of_estimate_only_finds_the_wind_while_another_controller_acts() -> None:
    acting = controller("flatness")
    policy: Any = controller("adrc-matched")
    hybrid = EstimateOnly(policy)
    env = make_vec(3, wind=Constant(FORCES), max_episode_steps=None)
    memories: list[Any] = [None, None]
    observation, _ = env.reset(seed=0, options={"reference": Reference.hover()})
    for _ in range(400):
        action, memories[0] = acting.predict(observation, memories[0])
        _, memory = hybrid.observe(observation, memories[1], np.full(3, memories[1] is None))
        applied, memories[1] = hybrid.act(action, memory)
        assert_array_equal(applied, action)
        observation, *_, info = env.step(applied)
    found = policy.estimated_disturbance(memories[1].controller)
    assert_allclose(found, info["disturbance"], atol=0.01)


@pytest.mark.parametrize(
    ("number", "names"),
    [
        (0, ["position_bandwidth"]),
        (1, ["pendulum_bandwidth", "far_pendulum_bandwidth"]),
        (2, ["attitude_bandwidth", "far_attitude_bandwidth"]),
        (3, ["vertical_bandwidth"]),
    ],
)
@pytest.mark.parametrize(("component", "factor"), [(1.0, 1.5), (-1.0, 1.0 / 1.5), (0.5, np.sqrt(1.5))])
def test_component_of_the_action_scales_its_bandwidth(
    number: int, names: list[str], component: float, factor: float
) -> None:
    """By (1 + κ)^a: the controller acts as with gains that are scaled by hand, and not as with the nominal ones."""
    gains: Any = GAINS["flatness"]
    scaled = replace(gains, **{name: factor * getattr(gains, name) for name in names})
    agent = constant(*(component * np.eye(4)[number]))
    policies = [
        HybridPolicy(BandwidthScheduling("flatness", 0.5), agent),
        OutputFeedback(Flatness, scaled),
        OutputFeedback(Flatness, gains),
    ]
    scheduled, by_hand, nominal = (
        run_policy(policy, make_vec(3, wind="windy", **SAME_STEP), 30)[0] for policy in policies
    )
    assert_allclose(scheduled, by_hand, atol=1e-5)
    assert np.abs(np.subtract(scheduled, nominal)).max() > 1e-3


def test_rows_that_begin_an_episode_start_fresh_and_the_others_continue() -> None:
    hybrid = ResidualAction("flatness", 1.0)
    observation, _ = make_vec(4, wind="windy").reset(seed=0)
    _, memory = hybrid.act(zero_action(observation), hybrid.observe(observation, None, np.ones(4, np.bool_))[1])
    later, _ = make_vec(4).reset(seed=9)
    started = np.array([False, True, False, True])
    seen, _ = hybrid.observe(later, memory, started)
    fresh, _ = hybrid.observe(later, None, started)
    continued, _ = hybrid.observe(later, memory, np.zeros(4, np.bool_))
    assert_array_equal(seen[started], fresh[started])
    assert_array_equal(seen[~started], continued[~started])
    assert (fresh != continued).any(axis=1).all()


HYBRID_EXAMPLES: list[tuple[Callable[[], Hybrid], dict[str, Any]]] = [
    (lambda: EstimateOnly("lqi"), {"kind": "estimate_only", "base_controller": "lqi"}),
    (
        lambda: ResidualAction("flatness", action_scale=0.3),
        {"kind": "residual_action", "base_controller": "flatness", "action_scale": 0.3, "fallback_gain": 0.0},
    ),
    (
        lambda: BandwidthScheduling(fallback_gain=3),
        {"kind": "bandwidth_scheduling", "base_controller": "flatness", "action_scale": 1.0, "fallback_gain": 3.0},
    ),
]


@pytest.mark.parametrize(("make", "data"), HYBRID_EXAMPLES)
def test_hybrid_survives_plain_data(make: Callable[[], Hybrid], data: dict[str, Any]) -> None:
    assert make().as_data() == data
    again = hybrid_from_data(data)
    assert type(again) is type(make())
    assert again.as_data() == data
    assert set(HYBRIDS) == {example["kind"] for _, example in HYBRID_EXAMPLES}


@pytest.mark.parametrize(("make", "data"), HYBRID_EXAMPLES)
def test_with_simulation_changes_the_base_controller_only(make: Callable[[], Hybrid], data: dict[str, Any]) -> None:
    heavy = Simulation(Parameters(bob_mass=0.3))
    hybrid = make()
    other = hybrid.with_simulation(heavy)
    assert other.base_controller.simulation == heavy
    assert hybrid.base_controller.simulation == Simulation()
    assert other.as_data() == data


class NoObserver:
    """A controller that does not estimate the disturbance."""

    def predict(self, *_: Any) -> Any:
        return None

    def __repr__(self) -> str:
        return "NoObserver()"


RESIDUAL = {"kind": "residual_action", "base_controller": "flatness"}


@pytest.mark.parametrize(
    ("make", "message", "kind"),
    [
        (lambda: EstimateOnly(NoObserver()), r"estimates the disturbance, not NoObserver\(\)", TypeError),
        (lambda: EstimateOnly("nix"), "no controller 'nix'", ValueError),
        (lambda: ResidualAction("lqr", 0.0), "action_scale must be above zero", ValueError),
        (lambda: ResidualAction("lqr", 4.0), r"action_scale .* \[0, 3\], not 4.0", ValueError),
        (lambda: ResidualAction("lqr", np.nan), "action_scale .* not nan", ValueError),
        (lambda: ResidualAction("lqr", "much"), "action_scale must be a number, not 'much'", TypeError),  # type: ignore[arg-type]
        *(
            (lambda name=name: BandwidthScheduling(name), "only the flatness-based .* has bandwidths", TypeError)
            for name in AVAILABLE_CONTROLLERS
            if not name.startswith(("flatness", "swing-up"))
        ),
        (lambda: BandwidthScheduling("swing-up"), "a controller that estimates the disturbance", TypeError),
        (lambda: EstimateOnly(controller("lqr")).as_data(), "base controller is given by name, not as", ValueError),
        (lambda: hybrid_from_data("flatness"), "hybrid must be a mapping with a kind, not 'flatness'", TypeError),
        (
            lambda: hybrid_from_data({"kind": "all"}),
            "kind .* one of estimate_only, residual_action, bandwidth_scheduling, not 'all'",
            ValueError,
        ),
        (lambda: hybrid_from_data({**RESIDUAL, "kind": ["all"]}), r"not \['all'\]", ValueError),
        (
            lambda: hybrid_from_data({**RESIDUAL, "gain": 1.0}),
            "no field 'gain'; its fields are base_controller, action_scale, fallback_gain",
            ValueError,
        ),
        (lambda: hybrid_from_data({"kind": "residual_action"}), "name of a controller, not None", TypeError),
        (
            lambda: hybrid_from_data({"kind": "estimate_only", "base_controller": "lqr", "fallback_gain": 1.0}),
            "estimate_only has no field 'fallback_gain'",
            ValueError,
        ),
    ],
)
def test_impossible_hybrids_are_refused(make: Any, message: str, kind: Any) -> None:
    assert_refused(make, message, kind)
