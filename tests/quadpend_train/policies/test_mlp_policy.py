"""The MLP policy: its network, its observations, the same actions as in wrapped environments, and its file."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_baselines.hybrid.lab import LAB_SIZE
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.tasks.observation import FULL, LAB, OUTPUT_FEEDBACK
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.bad_input import assert_refused
from tests.helpers.controllers import run_policy
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.policies import ESTIMATE_ONLY, RESIDUAL_ACTION, card, layers, mlp_policy
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


def test_a_policy_that_takes_no_repeated_samples_has_no_linear_model() -> None:
    """At hover without noise all samples repeat: differences from there are not those of a flight."""
    shape = [np.zeros(size, np.float32) for size in ((LAB_SIZE, 4), (4,))]
    policy = MlpPolicy([(shape[0], shape[1])], card(hybrid={"kind": "lab_only", "base_controller": "lqg"}))
    scenario = replace(find_scenario("flight_breeze"), observation=LAB)
    assert not policy.adapt(scenario).has_linear_model
    assert mlp_policy(36).has_linear_model


def test_wrong_observations_and_sampling_are_refused() -> None:
    policy, estimating = mlp_policy(36), mlp_policy(45, hybrid=ESTIMATE_ONLY)
    assert_refused(lambda: policy.predict(np.zeros((3, 4))), r"36 numbers, not of shape \(3, 4\)", ValueError)
    assert_refused(lambda: policy.predict(OBSERVATIONS, deterministic=False), "acts deterministically", ValueError)
    assert estimating.layouts == (FULL, OUTPUT_FEEDBACK, LAB)
    assert_refused(lambda: estimating.predict(np.zeros(45)), "36 or 27 or 37 numbers", ValueError)


ADRC = {"base_controller": "adrc-matched"}
INTERFACES: dict[str, tuple[int, dict[str, Any]]] = {
    "estimate": (45, {"hybrid": {**ESTIMATE_ONLY, **ADRC}}),
    "residual": (49, {"hybrid": {**RESIDUAL_ACTION, "action_scale": 0.3}}),
}


@pytest.mark.parametrize(("inputs", "fields"), INTERFACES.values(), ids=INTERFACES.keys())
def test_policy_in_the_plain_environment_equals_its_network_in_the_wrapped_one(
    inputs: int, fields: dict[str, Any]
) -> None:
    """Across the ends of episodes, which come at another time in each sub-environment."""
    policy = mlp_policy(inputs, **fields)
    actions, results = run_policy(policy, make_vec(5, **BRIEF), 60)
    env = VectorHybridWrapper(make_vec(5, **BRIEF), fields["hybrid"])
    seen, _ = env.reset(seed=5)
    for action, expected in zip(actions, results, strict=True):
        output = policy.forward(seen)
        if fields["hybrid"]["kind"] == "estimate_only":
            assert_array_equal(output, action)
        seen, *rest, info = env.step(output)
        assert_same(rest, list(expected[1:4]))
        assert_array_equal(info["tracking_error"], expected[4]["tracking_error"])
    over = np.array([step[2] | step[3] for step in results])
    assert over.sum(axis=0).min() >= 2
    assert (over.any(axis=1) & ~over.all(axis=1)).any()


def test_a_policy_that_repeats_its_actions_is_refused() -> None:
    mlp_policy(36, action_repeat=1)
    assert_refused(lambda: mlp_policy(36, action_repeat=3), "repeat their actions fly in version 0.3 only", ValueError)


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


@pytest.mark.parametrize(("inputs", "fields"), [(36, {}), (49, {"hybrid": RESIDUAL_ACTION})], ids=str)
def test_saved_policy_is_loaded_unchanged(inputs: int, fields: dict[str, Any], tmp_path: Path) -> None:
    policy = mlp_policy(inputs, **fields, note=[[0, 0.5, "ä"]], settings={"a": {"b": None}})
    policy.save(tmp_path / "policy.npz")
    loaded = MlpPolicy.load(tmp_path / "policy.npz")
    assert loaded.card == policy.card
    assert_same(loaded.layers, policy.layers)
    assert_array_equal(loaded.predict(OBSERVATIONS)[0], policy.predict(OBSERVATIONS)[0])
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "policy.npz").read_bytes()


class Bomb:
    """An object that creates a file when it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("exploded"),)


NAN, WIDE = np.full((6, 4), np.nan, np.float32), np.zeros((36, 8))
WRONG: dict[str, Any] = {
    "code": ({"weights_0": np.array([Bomb()], object)}, {}, "allow_pickle"),
    "code in the card": ({"card": np.array([Bomb()], object)}, {}, "allow_pickle"),
    "no JSON": ({"card": np.array("{")}, {}, "Expecting"),
    "nan": ({"weights_2": NAN}, {}, "of float32 and finite, with 4 outputs"),
    "double precision": ({"weights_0": WIDE}, {}, "of float32 and finite"),
    "layers that do not fit": ({"weights_1": np.zeros((5, 6), np.float32)}, {}, "size 5"),
    "a card for more inputs": ({}, {"hybrid": ESTIMATE_ONLY}, "takes 36 numbers, not 45"),
    "another format": ({}, {"format": "quadpend policy 9"}, "card.format must be 'quadpend policy 2'"),
}


@pytest.mark.parametrize(("arrays", "fields", "reason"), WRONG.values(), ids=WRONG.keys())
def test_wrong_file_is_refused_in_one_sentence_and_executes_nothing(
    arrays: Any, fields: Any, reason: str, tmp_path: Path
) -> None:
    right: dict[str, Any] = {"card": np.array(json.dumps(card(**fields)))}
    for i, (weights, biases) in enumerate(layers(36, 8, 6, 4)):
        right |= {f"weights_{i}": weights, f"biases_{i}": biases}
    np.savez(tmp_path / "wrong.npz", **{**right, **arrays})
    assert_refused(lambda: MlpPolicy.load(tmp_path / "wrong.npz"), f"wrong.npz is not a policy file: .*{reason}")
    assert not Path("exploded").exists()
