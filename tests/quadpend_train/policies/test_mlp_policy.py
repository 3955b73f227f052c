"""A learned policy in a file: it comes back as it was, executes nothing, and flies what it was trained to see."""

import json
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from quadpend_baselines.hybrid.companion import Companion
from stable_baselines3.common.evaluation import evaluate_policy

from quadpend_baselines import controller
from quadpend_baselines.hybrid.wrappers import VectorWithCompanion
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.wrappers import VectorHistoryWrapper, VectorOutputFeedbackWrapper
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.mlp_policy import MlpPolicy, difference
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.hybrid import Steered, flown
from tests.helpers.mlp_policies import card, layers, learned
from tests.helpers.sources import HEAVY, ROOT
from tests.helpers.wrappers import SHORT

SEEN = np.random.default_rng(3).normal(size=(7, 36)).astype(np.float32)
BRIEF = {"wind": "windy", "autoreset_mode": "SameStep", **SHORT}


@pytest.mark.parametrize("squashed", [False, True])
@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
def test_a_policy_is_its_network(activation: str, squashed: bool) -> None:
    """Computed here in double precision, layer by layer; clipped where it is not squashed."""
    policy = MlpPolicy(layers(36, 16, 8, 4, scale=0.5), card(activation=activation, squashed=squashed))
    bend: Any = {
        "relu": lambda x: x * (x > 0.0),
        "tanh": np.tanh,
        "elu": lambda x: np.where(x > 0.0, x, np.exp(x) - 1.0),
    }[activation]
    signal = SEEN.astype(np.float64)
    for weights, biases in policy.layers[:-1]:
        signal = bend(signal @ weights.astype(np.float64) + biases)
    signal = signal @ policy.layers[-1][0].astype(np.float64) + policy.layers[-1][1]
    action, memory = policy.predict(SEEN)
    assert_allclose(action, np.tanh(signal) if squashed else np.clip(signal, -1.0, 1.0), atol=1e-5)
    assert action.dtype == np.float32
    assert memory is None
    assert np.abs(signal).max() > 1.0


def test_one_observation_is_a_row_of_many() -> None:
    for policy in (learned(36), learned(36 * 3 + 8, {"history": 3, "history_actions": 2})):
        many, memory = policy.predict(SEEN)
        memories = [policy.predict(row)[1] for row in SEEN]
        again, _ = policy.predict(SEEN[::-1].copy(), memory)
        for row in range(len(SEEN)):
            one, _ = policy.predict(SEEN[row])
            assert one.shape == (4,)
            assert_allclose(one, many[row], atol=1e-6)
            later, _ = policy.predict(SEEN[-1 - row], memories[row])
            assert_allclose(later, again[row], atol=1e-6)


@pytest.mark.parametrize("view", [{}, {"history": 2}, {"companion": "flatness", "steers": "pace"}], ids=str)
def test_what_is_saved_is_loaded(view: dict[str, Any], tmp_path: Path) -> None:
    """The same actions to the bit, and the card with all that it says."""
    inputs = 45 if "companion" in view else 36 * view.get("history", 1)
    policy = learned(inputs, view, curve=[[0, 0.5, "ä"]], settings={"a": {"b": None}})
    policy.save(tmp_path / "policy.npz")
    loaded = MlpPolicy.load(tmp_path / "policy.npz")
    assert loaded.card == policy.card
    assert_same(loaded.layers, policy.layers)
    assert_array_equal(loaded.predict(SEEN)[0], policy.predict(SEEN)[0])
    assert difference(loaded, policy) == 0.0
    assert [path.name for path in tmp_path.iterdir()] == ["policy.npz"]
    loaded.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "policy.npz").read_bytes()


def test_an_interruption_while_saving_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "policy.npz"
    learned(36).save(path)

    def interrupted(file: Any, **_: Any) -> None:
        file.write(b"half of it")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", interrupted)
        with pytest.raises(KeyboardInterrupt):
            learned(36, seed=1).save(path)
    assert difference(MlpPolicy.load(path), learned(36)) == 0.0


def test_differences_are_the_largest_of_any_weight_and_infinite_between_other_networks() -> None:
    policy, other = learned(36), learned(36)
    other.layers[1][1][3] += 0.25
    assert difference(policy, other) == pytest.approx(0.25)
    assert difference(policy, learned(27)) == np.inf
    assert difference(policy, MlpPolicy(layers(36, 8, 4), card())) == np.inf


class Bomb:
    """Executed where it is unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("exploded"),)


@pytest.mark.parametrize("name", ["card", "weights_0", "another"])
def test_no_file_is_executed(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arrays = parts()
    arrays[name] = np.array([Bomb()], object)
    np.savez(tmp_path / "bomb.npz", allow_pickle=True, **arrays)
    (tmp_path / "pickle.npz").write_bytes(pickle.dumps(Bomb()))
    for path in ("bomb.npz", "pickle.npz"):
        assert_refused(
            lambda path=path: MlpPolicy.load(path), "is no learned policy: .*(allow_pickle|zip file)", ValueError
        )
    assert not Path("exploded").exists()


def parts(view: dict[str, Any] | None = None, inputs: int = 36, **changes: Any) -> dict[str, Any]:
    """What is in the file of a policy."""
    arrays: dict[str, Any] = {"card": np.array(json.dumps(card(view, **changes)))}
    for i, (weights, biases) in enumerate(layers(inputs, 8, 6, 4)):
        arrays |= {f"weights_{i}": weights, f"biases_{i}": biases}
    return arrays


def without(*names: str) -> dict[str, Any]:
    return {name: array for name, array in parts().items() if name not in names}


def with_number(name: str, number: float) -> dict[str, Any]:
    arrays = parts()
    arrays[name].flat[2] = number
    return arrays


def with_companion(**view: Any) -> dict[str, Any]:
    return parts({"companion": "flatness", **view}, 45)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no card": (without("card"), "no 'card'"),
    "no weights": (without("weights_1"), "weights_1"),
    "no biases": (without("biases_2"), "biases_2|weights_2"),
    "no layer": (without("weights_1", "biases_1"), "weights_1"),
    "no layers": ({"card": parts()["card"]}, "no layers"),
    "something else": ({**parts(), "more": np.zeros(3), "other": np.zeros(3)}, "also holds more, other|weights_3"),
    "one thing more": ({**parts(), "more": np.zeros(3)}, "also holds more"),
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
        "puts out 5 numbers, not an action's 4",
    ),
    "another observation": (parts(inputs=30), "takes 30 numbers, not the 36 or 27"),
    "a view of more": (parts({"history": 2}), "takes 36 numbers, not the 72 or 54"),
    "another format": (parts(format="quadpend policy 9"), "not of the format 'quadpend policy 1'"),
    "another activation": (parts(activation="gelu"), "activation must be one of relu, tanh, elu, not 'gelu'"),
    "activations": (parts(activation=["relu"]), "activation must be one of relu, tanh, elu|unhashable"),
    "squashed a little": (parts(squashed=0.5), "squashed must be true or false, not 0.5"),
    "no view": (
        {**parts(), "card": np.array(json.dumps({**card(), "view": None}))},
        "its view must have companion, steers",
    ),
    "an unknown view": (parts({"mirror": True}), "its view must have companion, steers"),
    "half a history": (parts({"history": 1.5}), "its view must have"),
    "no observation": (parts({"history": 0}), "history of at least 1"),
    "less than no action": (parts({"history_actions": -1}), "history of at least 1"),
    "an unknown companion": (with_companion(companion="nix"), "no controller 'nix'"),
    "steering something else": (with_companion(steers="all"), "steers must be one of"),
    "too much authority": (with_companion(authority=30.0), "authority .* not 30.0"),
    "caution about one that acts alone": (with_companion(caution=1.0), "no controller to fall back on"),
    "a companion without pace": (with_companion(companion="lqr", steers="pace"), "has a pace"),
    "no JSON": ({**parts(), "card": np.array("{")}, "Expecting"),
    "a list": ({**parts(), "card": np.array("[]")}, "its card is not of the format"),
    "numbers for a card": ({**parts(), "card": np.zeros(3)}, "Extra data|Expecting"),
    "a card without end": ({**parts(), "card": np.array("[" * 100_000)}, "recursion"),
}


@pytest.mark.parametrize(("arrays", "reason"), WRONG.values(), ids=WRONG.keys())
def test_what_makes_no_policy_is_refused(arrays: dict[str, Any], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.npz"
    np.savez(path, **arrays)
    assert_refused(lambda: MlpPolicy.load(path), rf"wrong.npz is no learned policy: .*({reason})", ValueError)


def damages(whole: bytes) -> dict[str, bytes]:
    """A file with a flipped byte in many places, cut off in some, or that never was one."""
    every = range(0, len(whole), 29)
    flipped = {f"byte {i}": whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :] for i in every}
    cut = {f"cut at {i}": whole[:i] for i in range(0, len(whole), 200)}
    return {**flipped, **cut, "text": b"weights and biases\n", "zeros": bytes(1000)}


def test_a_damaged_file_is_refused_or_as_good_as_whole(tmp_path: Path) -> None:
    """Some bytes, such as those of a date, do not count."""
    policy, path = learned(36), tmp_path / "policy.npz"
    policy.save(path)
    whole = path.read_bytes()
    unharmed = 0
    for name, damaged in damages(whole).items():
        path.write_bytes(damaged)
        try:
            loaded = MlpPolicy.load(path)
        except Exception as error:
            told = isinstance(error, ValueError) and "is no learned policy: " in str(error)
            if not told:
                pytest.fail(f"{name}: {error!r}")
        else:
            unharmed += 1
            assert difference(loaded, policy) == 0.0, name
            assert loaded.card == policy.card, name
    assert unharmed < 0.3 * len(damages(whole))


def test_an_array_alone_or_one_that_is_too_large_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "array.npy", np.zeros(3))
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (10000000000000, 8)}"
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        padded = header.ljust(117) + b"\n"
        archive.writestr("weights_0.npy", b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded)
    for name in ("array.npy", "huge.npz"):
        assert_refused(lambda name=name: MlpPolicy.load(tmp_path / name), "is no learned policy: ", ValueError)


def test_a_name_that_is_none_is_refused(tmp_path: Path) -> None:
    assert_refused(lambda: MlpPolicy.load("nix"), "there is no learned policy 'nix'", ValueError)
    assert_refused(lambda: MlpPolicy.load(tmp_path), "there is no learned policy", ValueError)


def test_what_a_policy_cannot_do_it_says() -> None:
    policy = learned(36)
    assert_refused(
        lambda: policy.predict(np.zeros(27)), r"takes observations of 36 numbers, not of shape \(27,\)", ValueError
    )
    assert_refused(lambda: policy.predict(np.zeros((3, 4))), r"36 numbers, not of shape \(3, 4\)", ValueError)
    assert_refused(lambda: policy.predict(SEEN, deterministic=False), "acts deterministically", ValueError)
    steered = learned(45, {"companion": "flatness"})
    assert steered.sizes == (36, 27)
    assert_refused(lambda: steered.predict(np.zeros(45)), "36 or 27 numbers", ValueError)


VIEWS: dict[str, tuple[int, dict[str, Any]]] = {
    "observations": (36 * 3, {"history": 3}),
    "observations and actions": (36 * 3 + 4 * 2, {"history": 3, "history_actions": 2}),
    "actions": (36 + 4, {"history_actions": 1}),
    "alone": (45, {"companion": "adrc-matched"}),
    "action": (49, {"companion": "flatness", "steers": "action", "authority": 0.3}),
    "action, adrc": (49, {"companion": "adrc-matched", "steers": "action", "authority": 0.3}),
    "pace": (45, {"companion": "flatness", "steers": "pace", "authority": 0.7}),
    "cautious pace": (45, {"companion": "flatness", "steers": "pace", "authority": 0.7, "caution": 2.0}),
    "action and history": (49 * 2 + 4, {"companion": "lqi", "steers": "action", "history": 2, "history_actions": 1}),
}


@pytest.mark.parametrize(("inputs", "view"), VIEWS.values(), ids=VIEWS.keys())
def test_a_policy_flies_the_plain_environment_as_its_network_flies_the_wrapped_one(
    inputs: int, view: dict[str, Any]
) -> None:
    """Through the ends of episodes, which come at another time in each row."""
    policy = learned(inputs, view)
    actions, returns = flown(policy, make_vec(5, **BRIEF), 60)
    env: Any = make_vec(5, **BRIEF)
    if "companion" in view:
        env = VectorWithCompanion(
            env, view["companion"], view.get("steers", "alone"), view.get("authority", 1.0), view.get("caution", 0.0)
        )
    if "history" in view or "history_actions" in view:
        env = VectorHistoryWrapper(env, view.get("history", 1), view.get("history_actions", 0))
    seen, _ = env.reset(seed=5)
    for action, expected in zip(actions, returns, strict=True):
        network = policy.act(seen)
        if view.get("steers", "alone") == "alone":
            assert_array_equal(network, action)
        seen, *rest, info = env.step(network)
        assert_same(rest, list(expected[1:4]))
        assert_array_equal(info["tracking_error"], expected[4]["tracking_error"])
    over = np.array([step[2] | step[3] for step in returns])
    assert over.sum(axis=0).min() >= 2
    assert (over.any(axis=1) & ~over.all(axis=1)).any()


def test_an_action_is_held() -> None:
    """What steers the companion is decided anew at every third step of an episode, and the companion acts at each."""
    policy = learned(49, {"companion": "flatness", "steers": "action", "hold": 3})
    decided: list[Any] = []

    def learner(seen: Floats32) -> Floats32:
        decided.append(policy.act(seen) if len(decided) % 3 == 0 else decided[-1])
        return decided[-1]

    calm: dict[str, Any] = {"max_episode_steps": None, "autoreset_mode": "SameStep"}
    expected, _ = flown(Steered(Companion(controller("flatness"), "action"), learner), make_vec(3, **calm), 20)
    assert_array_equal(flown(policy, make_vec(3, **calm), 20)[0], expected)
    memory, started = None, np.zeros(7, np.bool_)
    for step in range(5):
        started[2] = step == 4
        before, (_, memory) = memory, policy.predict(SEEN * (1.0 + step), memory, started)
    assert_array_equal(memory.held[:2], before.held[:2])  # type: ignore[attr-defined]
    assert (memory.held[2] != before.held[2]).any()  # type: ignore[attr-defined]


def test_a_policy_that_sees_no_velocities_flies_without() -> None:
    env = VectorOutputFeedbackWrapper(make_vec(3, **BRIEF))
    for policy in (learned(27), learned(49, {"companion": "flatness", "steers": "action"})):
        actions, _ = flown(policy, env, 20)
        assert np.shape(actions) == (20, 3, 4)


def test_rows_that_begin_anew_remember_nothing() -> None:
    policy = learned(36 * 3 + 8, {"history": 3, "history_actions": 2}, activation="tanh")
    memory = None
    for _ in range(4):
        before, memory = policy.predict(SEEN, memory)
    started = np.arange(7) % 2 == 0
    action, _ = policy.predict(SEEN, memory, started)
    assert_array_equal(action[started], policy.predict(SEEN)[0][started])
    assert_array_equal(action[~started], policy.predict(SEEN, memory)[0][~started])
    assert (policy.predict(SEEN)[0] != before).any(axis=1).all()


def test_a_memory_once_given_does_not_change() -> None:
    policy = learned(49 * 2 + 4, {"companion": "flatness", "steers": "action", "history": 2, "history_actions": 1})
    _, memory = policy.predict(SEEN)
    first = policy.predict(SEEN, memory)[0]
    for _ in range(3):
        policy.predict(SEEN[::-1].copy(), policy.predict(SEEN, memory)[1])
    assert_array_equal(policy.predict(SEEN, memory)[0], first)


def test_a_correction_of_nothing_is_the_companion() -> None:
    zero = [(0.0 * weights, 0.0 * biases) for weights, biases in layers(49, 8, 4)]
    policy = MlpPolicy(zero, card({"companion": "flatness", "steers": "action"}))
    for one, other in zip(
        rollout(policy, make_vec(3, **BRIEF), 0),
        rollout(controller("flatness"), make_vec(3, **BRIEF), 0),
        strict=True,
    ):
        assert_array_equal(one.action, other.action)
        assert_array_equal(one.tracking_error, other.tracking_error)


def test_a_policy_is_told_what_its_companion_should_believe() -> None:
    heavy = Simulation(Parameters(bob_mass=0.3))
    plain, policy = learned(36), learned(45, {"companion": "flatness"})
    assert plain.with_simulation(heavy) is plain
    told = policy.with_simulation(heavy)
    assert told._companion.controller.simulation == heavy
    assert policy._companion.controller.simulation == Simulation()
    env: Any = VectorWithCompanion(make_vec(4, simulation=heavy), "flatness", "alone", 1.0)
    seen, observation = env.reset(seed=0)[0], make_vec(4, simulation=heavy).reset(seed=0)[0]
    assert_array_equal(told.predict(observation)[0], policy.act(seen))


def test_stable_baselines_evaluates_it() -> None:
    returns, lengths = evaluate_policy(
        learned(36 * 2, {"history": 2}),  # type: ignore[arg-type]
        SB3VecEnv(make_vec(2, **BRIEF)),
        n_eval_episodes=4,
        return_episode_rewards=True,
        warn=False,
    )
    assert len(returns) == len(lengths) == 4  # type: ignore[arg-type]


def test_flying_needs_nothing_heavy(tmp_path: Path) -> None:
    learned(49, {"companion": "flatness", "steers": "action"}).save(tmp_path / "policy.npz")
    code = (
        "import sys; import numpy; from quadpend_train.policies.mlp_policy import LearnedPolicy;"
        f"print(LearnedPolicy.load({str(tmp_path / 'policy.npz')!r}).predict(numpy.zeros((2, 36)))[0].shape);"
        "print(*sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("(2, 4)")
    assert not (HEAVY | {"sb3_contrib", "pandas", "tyro"}) & set(ran.stdout.split())
