"""The MLP policy: its network, its observations, the same actions as in wrapped environments, and its file."""

import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3.common.evaluation import evaluate_policy

from quadpend_baselines.hybrid import ResidualAction, VectorHybridWrapper
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.wrappers import VectorHistoryWrapper
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


# Files


@pytest.mark.parametrize(
    ("inputs", "fields"), [(36, {}), (72, {"history": 2}), (45, {"hybrid": BANDWIDTH_SCHEDULING})], ids=str
)
def test_saved_policy_is_loaded_unchanged(inputs: int, fields: dict[str, Any], tmp_path: Path) -> None:
    policy = mlp_policy(inputs, **fields, note=[[0, 0.5, "ä"]], settings={"a": {"b": None}})
    policy.save(tmp_path / "policy.npz")
    loaded = MlpPolicy.load(tmp_path / "policy.npz")
    assert loaded.card == policy.card
    assert_same(loaded.layers, policy.layers)
    assert_array_equal(loaded.predict(OBSERVATIONS)[0], policy.predict(OBSERVATIONS)[0])
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "policy.npz").read_bytes()


def parts(inputs: int = 36, **fields: Any) -> dict[str, Any]:
    """Arrays in a policy file."""
    arrays: dict[str, Any] = {"card": np.array(json.dumps(card(**fields)))}
    for i, (weights, biases) in enumerate(layers(inputs, 8, 6, 4)):
        arrays |= {f"weights_{i}": weights, f"biases_{i}": biases}
    return arrays


def without(name: str) -> dict[str, Any]:
    return {key: array for key, array in parts().items() if key != name}


class Bomb:
    """An object that creates a file when it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("exploded"),)


BOMB = np.array([Bomb()], object)
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "code": ({**parts(), "weights_0": BOMB}, "allow_pickle"),
    "code in the card": ({**parts(), "card": BOMB}, "allow_pickle"),
    "no card": (without("card"), "no 'card'"),
    "no weights": (without("weights_1"), "weights_1"),
    "no layers": ({"card": parts()["card"]}, "no layers"),
    "something else": ({**parts(), "more": np.zeros(3)}, "also contains more"),
    "double precision": ({**parts(), "weights_1": parts()["weights_1"].astype(np.float64)}, "must be of float32"),
    "nan": ({**parts(), "biases_2": np.full(4, np.nan, np.float32)}, "layer 2 has numbers that are not finite"),
    "other biases": (
        {**parts(), "biases_1": np.zeros(5, np.float32)},
        r"layer 1 has weights \(8, 6\) and biases",
    ),
    "five actions": (
        {**parts(), "weights_2": np.zeros((6, 5), np.float32), "biases_2": np.zeros(5, np.float32)},
        "last layer must have 4 outputs, not 5",
    ),
    "another observation": (parts(inputs=30), "must take 36 or 27 numbers, .* not 30"),
    "a card for more inputs": (parts(history=2), "must take 72 or 54 numbers, .* not 36"),
    "other statistics": (parts(normalization={"mean": [0.0], "std": [1.0], "clip": 1.0}), "must have 36 numbers"),
    "a scale of zero": (parts(input_scales=[0.0]), "card.input_scales must be .*, not"),
    "another format": (parts(format="quadpend policy 9"), "card.format must be 'quadpend policy 2'"),
    "another activation": (parts(activation="gelu"), "card.activation must be 'relu', 'tanh' or 'elu'"),
    "half a history": (parts(history=1.5), "card.history must be .*, not 1.5"),
    "a name for a hybrid": (parts(hybrid="flatness"), "card.hybrid must be .*, not 'flatness'"),
    "an unknown base controller": (
        parts(45, hybrid={"kind": "estimate_only", "base_controller": "nix"}),
        "no controller 'nix'",
    ),
    "no JSON": ({**parts(), "card": np.array("{")}, "Expecting"),
    "a card without end": ({**parts(), "card": np.array("[" * 100_000)}, "recursion"),
}


@pytest.mark.parametrize(("arrays", "reason"), WRONG.values(), ids=WRONG.keys())
def test_invalid_file_is_refused_and_executes_nothing(arrays: dict[str, Any], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.npz"
    np.savez(path, **arrays)
    assert_refused(lambda: MlpPolicy.load(path), rf"wrong.npz is not a policy file: .*({reason})", ValueError)
    assert not Path("exploded").exists()


def test_damaged_file_is_refused_or_loads_the_same_policy(tmp_path: Path) -> None:
    """Some bytes, such as those of a date, do not matter."""
    policy, path = mlp_policy(36), tmp_path / "policy.npz"
    policy.save(path)
    whole, unharmed = path.read_bytes(), 0
    flipped = [whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :] for i in range(0, len(whole), 97)]
    damaged = [*flipped, *(whole[:i] for i in range(0, len(whole), 500)), b"weights and biases", bytes(1000)]
    for data in damaged:
        path.write_bytes(data)
        try:
            loaded = MlpPolicy.load(path)
        except ValueError as error:
            message = str(error)
            if "is not a policy file: " not in message:
                raise
        else:
            unharmed += 1
            assert weight_difference(loaded, policy) == 0.0
            assert loaded.card == policy.card
    assert unharmed < 0.3 * len(damaged)


def test_file_that_unpacks_to_more_than_a_policy_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "huge.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("weights_0.npy", bytes(65 * 2**20))
    assert_refused(lambda: MlpPolicy.load(tmp_path / "huge.npz"), "at most 67108864 bytes", ValueError)


def test_unknown_name_is_refused() -> None:
    assert_refused(lambda: MlpPolicy.load("nix"), "'nix' must be the path of a policy file or the name", ValueError)
