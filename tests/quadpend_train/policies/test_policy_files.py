"""Policy files: saving and loading, and files that are refused."""

import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same
from tests.helpers.policies import BANDWIDTH_SCHEDULING, card, layers, mlp_policy

OBSERVATIONS = np.random.default_rng(3).normal(size=(7, 36)).astype(np.float32)


@pytest.mark.parametrize(
    ("inputs", "fields"), [(36, {}), (72, {"history": 2}), (45, {"hybrid": BANDWIDTH_SCHEDULING})], ids=str
)
def test_saved_policy_is_loaded_unchanged(inputs: int, fields: dict[str, Any], tmp_path: Path) -> None:
    """The actions are exactly the same, and so is the card."""
    policy = mlp_policy(inputs, **fields, note=[[0, 0.5, "ä"]], settings={"a": {"b": None}})
    policy.save(tmp_path / "policy.npz")
    loaded = MlpPolicy.load(tmp_path / "policy.npz")
    assert loaded.card == policy.card
    assert_same(loaded.layers, policy.layers)
    assert_array_equal(loaded.predict(OBSERVATIONS)[0], policy.predict(OBSERVATIONS)[0])
    assert weight_difference(loaded, policy) == 0.0
    assert [path.name for path in tmp_path.iterdir()] == ["policy.npz"]
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "policy.npz").read_bytes()


def test_interrupted_save_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "policy.npz"
    mlp_policy(36).save(path)

    def interrupted(file: Any, **_: Any) -> None:
        file.write(b"half of it")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", interrupted)
        with pytest.raises(KeyboardInterrupt):
            mlp_policy(36, seed=1).save(path)
    assert weight_difference(MlpPolicy.load(path), mlp_policy(36)) == 0.0


class Bomb:
    """An object that creates a file when it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("exploded"),)


@pytest.mark.parametrize("name", ["card", "weights_0", "another"])
def test_loading_executes_nothing(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arrays = parts()
    arrays[name] = np.array([Bomb()], object)
    np.savez(tmp_path / "bomb.npz", allow_pickle=True, **arrays)
    (tmp_path / "pickle.npz").write_bytes(pickle.dumps(Bomb()))
    for path in ("bomb.npz", "pickle.npz"):
        assert_refused(
            lambda path=path: MlpPolicy.load(path), "is not a policy file: .*(allow_pickle|zip file)", ValueError
        )
    assert not Path("exploded").exists()


def parts(inputs: int = 36, **fields: Any) -> dict[str, Any]:
    """Arrays in a policy file."""
    arrays: dict[str, Any] = {"card": np.array(json.dumps(card(**fields)))}
    for i, (weights, biases) in enumerate(layers(inputs, 8, 6, 4)):
        arrays |= {f"weights_{i}": weights, f"biases_{i}": biases}
    return arrays


def without(*names: str) -> dict[str, Any]:
    return {name: array for name, array in parts().items() if name not in names}


def with_number(name: str, number: float) -> dict[str, Any]:
    arrays = parts()
    arrays[name].flat[2] = number
    return arrays


def without_field(name: str) -> dict[str, Any]:
    fields = {key: value for key, value in card().items() if key != name}
    return {**parts(), "card": np.array(json.dumps(fields))}


def with_hybrid(kind: str, **fields: Any) -> dict[str, Any]:
    return parts(45, hybrid={"kind": kind, "base_controller": "flatness", **fields})


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no card": (without("card"), "no 'card'"),
    "no weights": (without("weights_1"), "weights_1"),
    "no biases": (without("biases_2"), "biases_2|weights_2"),
    "no layer": (without("weights_1", "biases_1"), "weights_1"),
    "no layers": ({"card": parts()["card"]}, "no layers"),
    "something else": ({**parts(), "more": np.zeros(3), "other": np.zeros(3)}, "also contains more, other|weights_3"),
    "one thing more": ({**parts(), "more": np.zeros(3)}, "also contains more"),
    "double precision": ({**parts(), "weights_1": parts()["weights_1"].astype(np.float64)}, "must be of float32"),
    "whole numbers": ({**parts(), "biases_0": np.zeros(8, np.int32)}, "layer 0 must be of float32, not .*int32"),
    "nan": (with_number("weights_2", np.nan), "layer 2 has numbers that are not finite"),
    "infinite": (with_number("biases_0", np.inf), "layer 0 has numbers that are not finite"),
    "other biases": (
        {**parts(), "biases_1": np.zeros(5, np.float32)},
        r"layer 1 has weights \(8, 6\) and biases \(5,\)",
    ),
    "other weights": ({**parts(), "weights_1": np.zeros((7, 6), np.float32)}, r"layer 1 .* do not fit"),
    "flat weights": ({**parts(), "weights_0": np.zeros(288, np.float32)}, "layer 0 .* do not fit"),
    "a number": ({**parts(), "weights_0": np.float32(1.0)}, "layer 0 .* do not fit"),
    "five actions": (
        {**parts(), "weights_2": np.zeros((6, 5), np.float32), "biases_2": np.zeros(5, np.float32)},
        "last layer must have 4 outputs, not 5",
    ),
    "another observation": (parts(inputs=30), "must take 36 or 27 numbers, .* not 30"),
    "a card for two scales": (parts(input_scales=[8.0, 64.0]), "must take 108 or 81 numbers, .* not 36"),
    "a scale of zero": (parts(input_scales=[0.0]), r"input_scales\[0\] must be a finite number in .*, not 0.0"),
    "a scale that makes nan": (parts(input_scales=[8.0, 1e308]), r"input_scales\[1\] must be .*, not 1e\+308"),
    "a card for more inputs": (parts(history=2), "must take 72 or 54 numbers, .* not 36"),
    "another format": (parts(format="quadpend policy 9"), "not of the format 'quadpend policy 2'"),
    "another activation": (parts(activation="gelu"), "activation must be one of relu, tanh, elu, not 'gelu'"),
    "activations": (parts(activation=["relu"]), "activation must be one of relu, tanh, elu|unhashable"),
    "squashed a little": (parts(squashed=0.5), "squashed must be true or false, not 0.5"),
    "no hybrid": (without_field("hybrid"), "has no 'hybrid'"),
    "no history": (without_field("history"), "has no 'history'"),
    "half a history": (parts(history=1.5), "history must be a whole number of at least 1, not 1.5"),
    "no observation": (parts(history=0), "history must be a whole number of at least 1, not 0"),
    "less than no action": (parts(history_actions=-1), "history_actions must be a whole number of at least 0, not -1"),
    "no repetition": (parts(action_repeat=0), "action_repeat must be a whole number of at least 1, not 0"),
    "a name for a hybrid": (parts(hybrid="flatness"), "hybrid must be a mapping with a kind, not 'flatness'"),
    "an unknown base controller": (with_hybrid("estimate_only", base_controller="nix"), "no controller 'nix'"),
    "no base controller": (with_hybrid("estimate_only", base_controller=None), "name of a controller, not None"),
    "an unknown kind": (with_hybrid("all"), "kind of a hybrid must be one of"),
    "an unknown field": (with_hybrid("residual_action", mirror=True), "has no field 'mirror'"),
    "too large a scale": (with_hybrid("residual_action", action_scale=30.0), "action_scale .* not 30.0"),
    "a fallback without base action": (with_hybrid("estimate_only", fallback_gain=1.0), "no field 'fallback_gain'"),
    "no bandwidths": (with_hybrid("bandwidth_scheduling", base_controller="lqr"), "has bandwidths to scale"),
    "no JSON": ({**parts(), "card": np.array("{")}, "Expecting"),
    "a list": ({**parts(), "card": np.array("[]")}, "the card is not of the format"),
    "numbers for a card": ({**parts(), "card": np.zeros(3)}, "Extra data|Expecting"),
    "a card without end": ({**parts(), "card": np.array("[" * 100_000)}, "recursion"),
}


@pytest.mark.parametrize(("arrays", "reason"), WRONG.values(), ids=WRONG.keys())
def test_invalid_file_is_refused(arrays: dict[str, Any], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.npz"
    np.savez(path, **arrays)
    assert_refused(lambda: MlpPolicy.load(path), rf"wrong.npz is not a policy file: .*({reason})", ValueError)


def damages(whole: bytes) -> dict[str, bytes]:
    """A file with a flipped byte in many places, truncated files, and files of another kind."""
    every = range(0, len(whole), 29)
    flipped = {f"byte {i}": whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :] for i in every}
    cut = {f"cut at {i}": whole[:i] for i in range(0, len(whole), 200)}
    return {**flipped, **cut, "text": b"weights and biases\n", "zeros": bytes(1000)}


def test_damaged_file_is_refused_or_loads_the_same_policy(tmp_path: Path) -> None:
    """Some bytes, such as those of a date, do not matter."""
    policy, path = mlp_policy(36), tmp_path / "policy.npz"
    policy.save(path)
    whole = path.read_bytes()
    unharmed = 0
    for name, damaged in damages(whole).items():
        path.write_bytes(damaged)
        try:
            loaded = MlpPolicy.load(path)
        except Exception as error:
            clear = isinstance(error, ValueError) and "is not a policy file: " in str(error)
            if not clear:
                pytest.fail(f"{name}: {error!r}")
        else:
            unharmed += 1
            assert weight_difference(loaded, policy) == 0.0, name
            assert loaded.card == policy.card, name
    assert unharmed < 0.3 * len(damages(whole))


def test_array_alone_and_too_large_array_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "array.npy", np.zeros(3))
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (10000000000000, 8)}"
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        padded = header.ljust(117) + b"\n"
        archive.writestr("weights_0.npy", b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded)
    for name in ("array.npy", "huge.npz"):
        assert_refused(lambda name=name: MlpPolicy.load(tmp_path / name), "is not a policy file: ", ValueError)


def test_unknown_name_is_refused(tmp_path: Path) -> None:
    assert_refused(
        lambda: MlpPolicy.load("nix"), "'nix' must be the path of a policy file or the name of a policy", ValueError
    )
    assert_refused(lambda: MlpPolicy.load(tmp_path), "must be the path of a policy file", ValueError)
