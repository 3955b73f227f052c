"""The MLP policy: its network, its observations, and the same actions as in wrapped environments."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3.common.evaluation import evaluate_policy

from quadpend_baselines import controller
from quadpend_baselines.hybrid import EstimateOnly, ResidualAction, VectorHybridWrapper
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.wrappers import VectorHistoryWrapper, VectorOutputFeedbackWrapper
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from tests.helpers.bad_input import assert_refused
from tests.helpers.controllers import HybridPolicy, run_policy
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.policies import BANDWIDTH_SCHEDULING, ESTIMATE_ONLY, RESIDUAL_ACTION, card, layers, mlp_policy
from tests.helpers.sources import HEAVY, ROOT
from tests.helpers.wrappers import SHORT

OBSERVATIONS = np.random.default_rng(3).normal(size=(7, 36)).astype(np.float32)
BRIEF = {"wind": "windy", "autoreset_mode": "SameStep", **SHORT}


@pytest.mark.parametrize("squashed", [False, True])
@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
def test_action_is_the_output_of_the_network(activation: str, squashed: bool) -> None:
    """Compared with the layers in double precision; the output is clipped if it is not squashed."""
    policy = MlpPolicy(layers(36, 16, 8, 4, scale=0.5), card(activation=activation, squashed=squashed))
    function: Any = {
        "relu": lambda x: x * (x > 0.0),
        "tanh": np.tanh,
        "elu": lambda x: np.where(x > 0.0, x, np.exp(x) - 1.0),
    }[activation]
    signal = OBSERVATIONS.astype(np.float64)
    for weights, biases in policy.layers[:-1]:
        signal = function(signal @ weights.astype(np.float64) + biases)
    signal = signal @ policy.layers[-1][0].astype(np.float64) + policy.layers[-1][1]
    action, memory = policy.predict(OBSERVATIONS)
    assert_allclose(action, np.tanh(signal) if squashed else np.clip(signal, -1.0, 1.0), atol=1e-5)
    assert action.dtype == np.float32
    assert memory is None
    assert np.abs(signal).max() > 1.0


def test_single_observation_is_a_batch_of_one() -> None:
    for policy in (mlp_policy(36), mlp_policy(36 * 3 + 8, history=3, history_actions=2)):
        many, memory = policy.predict(OBSERVATIONS)
        memories = [policy.predict(row)[1] for row in OBSERVATIONS]
        again, _ = policy.predict(OBSERVATIONS[::-1].copy(), memory)
        for row in range(len(OBSERVATIONS)):
            one, _ = policy.predict(OBSERVATIONS[row])
            assert one.shape == (4,)
            assert_allclose(one, many[row], atol=1e-6)
            later, _ = policy.predict(OBSERVATIONS[-1 - row], memories[row])
            assert_allclose(later, again[row], atol=1e-6)


def test_weight_difference_is_the_largest_of_any_weight_and_infinite_between_other_shapes() -> None:
    policy, other = mlp_policy(36), mlp_policy(36)
    other.layers[1][1][3] += 0.25
    assert weight_difference(policy, other) == pytest.approx(0.25)
    assert weight_difference(policy, mlp_policy(27)) == np.inf
    assert weight_difference(policy, MlpPolicy(layers(36, 8, 4), card())) == np.inf


def test_wrong_observations_and_sampling_are_refused() -> None:
    policy = mlp_policy(36)
    assert_refused(
        lambda: policy.predict(np.zeros(27)), r"takes observations of 36 numbers, not of shape \(27,\)", ValueError
    )
    assert_refused(lambda: policy.predict(np.zeros((3, 4))), r"36 numbers, not of shape \(3, 4\)", ValueError)
    assert_refused(lambda: policy.predict(OBSERVATIONS, deterministic=False), "acts deterministically", ValueError)
    estimating = mlp_policy(45, hybrid=ESTIMATE_ONLY)
    assert estimating.observation_sizes == (36, 27)
    assert_refused(lambda: estimating.predict(np.zeros(45)), "36 or 27 numbers", ValueError)


ADRC = {"base_controller": "adrc-matched"}
INTERFACES: dict[str, tuple[int, dict[str, Any]]] = {
    "observations": (36 * 3, {"history": 3}),
    "observations and actions": (36 * 3 + 4 * 2, {"history": 3, "history_actions": 2}),
    "actions": (36 + 4, {"history_actions": 1}),
    "estimate": (45, {"hybrid": {**ESTIMATE_ONLY, **ADRC}}),
    "residual": (49, {"hybrid": {**RESIDUAL_ACTION, "action_scale": 0.3}}),
    "residual, adrc": (49, {"hybrid": {**RESIDUAL_ACTION, **ADRC, "action_scale": 0.3}}),
    "scheduling": (45, {"hybrid": {**BANDWIDTH_SCHEDULING, "action_scale": 0.7}}),
    "scheduling, fallback": (45, {"hybrid": {**BANDWIDTH_SCHEDULING, "action_scale": 0.7, "fallback_gain": 2.0}}),
    "residual and history": (
        49 * 2 + 4,
        {"hybrid": {**RESIDUAL_ACTION, "base_controller": "lqi"}, "history": 2, "history_actions": 1},
    ),
}


@pytest.mark.parametrize(("inputs", "fields"), INTERFACES.values(), ids=INTERFACES.keys())
def test_policy_in_the_plain_environment_equals_its_network_in_the_wrapped_one(
    inputs: int, fields: dict[str, Any]
) -> None:
    """Across the ends of episodes, which come at another time in each sub-environment."""
    policy = mlp_policy(inputs, **fields)
    actions, results = run_policy(policy, make_vec(5, **BRIEF), 60)
    env: Any = make_vec(5, **BRIEF)
    if "hybrid" in fields:
        env = VectorHybridWrapper(env, fields["hybrid"])
    if "history" in fields or "history_actions" in fields:
        env = VectorHistoryWrapper(env, fields.get("history", 1), fields.get("history_actions", 0))
    seen, _ = env.reset(seed=5)
    for action, expected in zip(actions, results, strict=True):
        output = policy.forward(seen)
        if fields.get("hybrid", ESTIMATE_ONLY)["kind"] == "estimate_only":
            assert_array_equal(output, action)
        seen, *rest, info = env.step(output)
        assert_same(rest, list(expected[1:4]))
        assert_array_equal(info["tracking_error"], expected[4]["tracking_error"])
    over = np.array([step[2] | step[3] for step in results])
    assert over.sum(axis=0).min() >= 2
    assert (over.any(axis=1) & ~over.all(axis=1)).any()


def test_action_repeat_uses_each_output_for_several_steps() -> None:
    """The network decides at every third step of an episode, and the base controller acts at every step."""
    policy = mlp_policy(49, hybrid=RESIDUAL_ACTION, action_repeat=3)
    outputs: list[Any] = []

    def agent(seen: Floats32) -> Floats32:
        outputs.append(policy.forward(seen) if len(outputs) % 3 == 0 else outputs[-1])
        return outputs[-1]

    calm: dict[str, Any] = {"max_episode_steps": None, "autoreset_mode": "SameStep"}
    expected, _ = run_policy(HybridPolicy(ResidualAction("flatness", 1.0), agent), make_vec(3, **calm), 20)
    assert_array_equal(run_policy(policy, make_vec(3, **calm), 20)[0], expected)
    memory, started = None, np.zeros(7, np.bool_)
    for step in range(5):
        started[2] = step == 4
        before, (_, memory) = memory, policy.predict(OBSERVATIONS * (1.0 + step), memory, started)
    assert_array_equal(memory.output[:2], before.output[:2])  # type: ignore[attr-defined]
    assert (memory.output[2] != before.output[2]).any()  # type: ignore[attr-defined]


def test_policy_runs_without_velocities_if_it_needs_none() -> None:
    env = VectorOutputFeedbackWrapper(make_vec(3, **BRIEF))
    for policy in (mlp_policy(27), mlp_policy(49, hybrid=RESIDUAL_ACTION)):
        actions, _ = run_policy(policy, env, 20)
        assert np.shape(actions) == (20, 3, 4)


def test_rows_that_begin_an_episode_forget_the_previous_one() -> None:
    policy = mlp_policy(36 * 3 + 8, history=3, history_actions=2, activation="tanh")
    memory = None
    for _ in range(4):
        before, memory = policy.predict(OBSERVATIONS, memory)
    started = np.arange(7) % 2 == 0
    action, _ = policy.predict(OBSERVATIONS, memory, started)
    assert_array_equal(action[started], policy.predict(OBSERVATIONS)[0][started])
    assert_array_equal(action[~started], policy.predict(OBSERVATIONS, memory)[0][~started])
    assert (policy.predict(OBSERVATIONS)[0] != before).any(axis=1).all()


def test_returned_memory_does_not_change_later() -> None:
    policy = mlp_policy(49 * 2 + 4, hybrid=RESIDUAL_ACTION, history=2, history_actions=1)
    _, memory = policy.predict(OBSERVATIONS)
    first = policy.predict(OBSERVATIONS, memory)[0]
    for _ in range(3):
        policy.predict(OBSERVATIONS[::-1].copy(), policy.predict(OBSERVATIONS, memory)[1])
    assert_array_equal(policy.predict(OBSERVATIONS, memory)[0], first)


def test_zero_residual_is_the_base_controller() -> None:
    zero = [(0.0 * weights, 0.0 * biases) for weights, biases in layers(49, 8, 4)]
    policy = MlpPolicy(zero, card(hybrid=RESIDUAL_ACTION))
    for one, other in zip(
        rollout(policy, make_vec(3, **BRIEF), 0),
        rollout(controller("flatness"), make_vec(3, **BRIEF), 0),
        strict=True,
    ):
        assert_array_equal(one.action, other.action)
        assert_array_equal(one.tracking_error, other.tracking_error)


def test_with_simulation_changes_the_base_controller_only() -> None:
    heavy = Simulation(Parameters(bob_mass=0.3))
    plain, policy = mlp_policy(36), mlp_policy(45, hybrid=ESTIMATE_ONLY)
    assert plain.with_simulation(heavy) is plain
    other: Any = policy.with_simulation(heavy)
    assert other.hybrid.base_controller.simulation == heavy
    assert policy.hybrid is not None
    assert policy.hybrid.base_controller.simulation == Simulation()
    env: Any = VectorHybridWrapper(make_vec(4, simulation=heavy), EstimateOnly("flatness"))
    seen, observation = env.reset(seed=0)[0], make_vec(4, simulation=heavy).reset(seed=0)[0]
    assert_array_equal(other.predict(observation)[0], policy.forward(seen))


BODY_RATES = Simulation(vehicle="hummingbird", interface="body_rates")


def test_policy_is_refused_where_an_action_commands_something_else() -> None:
    rates = mlp_policy(36, interface="body_rates", vehicle="hummingbird")
    assert rates.with_simulation(BODY_RATES) is rates
    assert_refused(
        lambda: rates.with_simulation(Simulation()), "command thrust and body rates.*commands thrust and torques"
    )
    trained_before = mlp_policy(36, settings={})
    assert trained_before.with_simulation(Simulation()) is trained_before
    assert_refused(lambda: trained_before.with_simulation(BODY_RATES), "'wrench'.*'body_rates'")


def test_policy_from_elsewhere_and_scheduled_bandwidths_fly_every_interface() -> None:
    elsewhere = mlp_policy(36)
    assert elsewhere.with_simulation(BODY_RATES) is elsewhere
    scheduled = mlp_policy(45, hybrid=BANDWIDTH_SCHEDULING, settings={})
    assert scheduled.with_simulation(BODY_RATES) is not scheduled


def test_policy_warns_of_another_vehicle() -> None:
    policy = mlp_policy(36, interface="body_rates", vehicle="hummingbird")
    with pytest.warns(UserWarning, match="trained on the vehicle hummingbird flies the vehicle x500"):
        policy.with_simulation(Simulation(vehicle="x500", interface="body_rates"))


def test_stable_baselines3_evaluates_a_policy() -> None:
    returns, lengths = evaluate_policy(
        mlp_policy(36 * 2, history=2),  # type: ignore[arg-type]
        SB3VecEnv(make_vec(2, **BRIEF)),
        n_eval_episodes=4,
        return_episode_rewards=True,
        warn=False,
    )
    assert len(returns) == len(lengths) == 4  # type: ignore[arg-type]


def test_running_a_policy_imports_nothing_heavy(tmp_path: Path) -> None:
    mlp_policy(49, hybrid=RESIDUAL_ACTION).save(tmp_path / "policy.npz")
    code = (
        "import sys; import numpy; from quadpend_train.policies.mlp_policy import MlpPolicy;"
        f"print(MlpPolicy.load({str(tmp_path / 'policy.npz')!r}).predict(numpy.zeros((2, 36)))[0].shape);"
        "print(*sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("(2, 4)")
    assert not (HEAVY | {"sb3_contrib", "pandas", "tyro"}) & set(ran.stdout.split())
