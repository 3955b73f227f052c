"""An exported policy acts like the model of Stable-Baselines3, or the export is refused with a reason."""

import json
import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.torch_layers import FlattenExtractor

from quadpend_gym.core.arrays import Floats32
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.export import export, export_zip
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, output_layer, read_zip
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import make_vec
from tests.helpers.wrappers import HISTORY, make_wrapped_vec

KINDS: dict[str, tuple[Any, dict[str, Any]]] = {
    "ppo": (PPO, {"n_steps": 4, "batch_size": 8}),
    "sac": (SAC, {"buffer_size": 8}),
    "tqc": (TQC, {"buffer_size": 8}),
}
algorithms = pytest.mark.parametrize("algo", KINDS)


def env() -> SB3VecEnv:
    return SB3VecEnv(make_vec(2, autoreset_mode="SameStep"))


def model(algo: str, around: Any = None, gain: float = 1.0, sde: bool = False, **policy: Any) -> Any:
    """An untrained model whose last weights are `gain` times as large."""
    kind, more = KINDS[algo]
    torch.set_num_threads(1)
    policy = {"net_arch": [8, 6], "activation_fn": torch.nn.ReLU, **policy}
    made = kind("MlpPolicy", around or env(), policy_kwargs=policy, use_sde=sde, seed=0, device="cpu", **more)
    with torch.no_grad():
        for parameter in output_layer(made).parameters():
            parameter *= gain
    return made


def observations(size: int = 36) -> Floats32:
    return np.random.default_rng(1).normal(size=(50, size)).astype(np.float32)


def assert_same_actions(policy: MlpPolicy, made: Any) -> None:
    observed = observations()
    expected, _ = made.predict(observed, deterministic=True)
    action, _ = policy.predict(observed)
    assert action.dtype == np.float32
    assert_allclose(action, expected, atol=1e-5)
    for row in range(3):
        assert_allclose(policy.predict(observed[row])[0], made.predict(observed[row], deterministic=True)[0], atol=1e-5)


@pytest.mark.parametrize("activation", ACTIVATION_MODULES)
@algorithms
def test_exported_policy_acts_like_the_model(algo: str, activation: str, tmp_path: Path) -> None:
    """For one observation and for many, before and after it is saved and loaded."""
    made = model(algo, activation_fn=ACTIVATION_MODULES[activation])
    policy = export(made, note="x")
    assert policy.card["activation"] == activation
    assert policy.card["squashed"] == (algo != "ppo")
    assert policy.card["note"] == "x"
    policy.save(tmp_path / "policy.npz")
    assert_same_actions(policy, made)
    assert_same_actions(MlpPolicy.load(tmp_path / "policy.npz"), made)


@algorithms
def test_exported_policy_has_the_input_scales_of_the_model(algo: str, tmp_path: Path) -> None:
    scales = {"features_extractor_class": MultiScaleInputs, "features_extractor_kwargs": {"scales": (3.0, 20.0)}}
    policy = export(made := model(algo, gain=20.0, **scales))
    assert policy.card["input_scales"] == [3.0, 20.0]
    assert policy.layers[0][0].shape == (3 * 36, 8)
    policy.save(tmp_path / "policy.npz")
    assert_same_actions(MlpPolicy.load(tmp_path / "policy.npz"), made)
    without = MlpPolicy(
        [(policy.layers[0][0][:36], policy.layers[0][1]), *policy.layers[1:]], {**policy.card, "input_scales": []}
    )
    assert np.abs(without.predict(observations())[0] - policy.predict(observations())[0]).max() > 0.1


@algorithms
def test_networks_of_any_depth_are_exported(algo: str) -> None:
    for depth in ([], [5], [9, 7, 5]):
        policy = export(model(algo, net_arch=depth))
        assert [weights.shape[1] for weights, _ in policy.layers] == [*depth, 4]


def test_policy_network_is_exported_not_the_value_network() -> None:
    made = model("ppo", net_arch={"pi": [7], "vf": [9, 9]})
    assert_same_actions(export(made), made)


@pytest.mark.parametrize("sde", [False, True], ids=["", "gSDE"])
@algorithms
def test_large_actions_are_limited_like_those_of_the_model(algo: str, sde: bool) -> None:
    """PPO clips actions; SAC and TQC squash them by a tanh, and with gSDE clip them before that."""
    made = model(algo, gain=300.0 if algo == "ppo" else 60.0, sde=sde)
    observed = observations()
    assert np.mean(np.abs(made.predict(observed, deterministic=True)[0]) > 0.95) > 0.2
    assert_same_actions(export(made), made)


@algorithms
def test_models_with_gsde_are_exported(algo: str) -> None:
    made = model(algo, sde=True)
    assert_same_actions(export(made), made)


def test_exported_policy_does_not_change_when_the_model_learns() -> None:
    made = model("ppo")
    policy = export(made)
    before = [weights.copy() for weights, _ in policy.layers]
    biases = [bias.copy() for _, bias in policy.layers]
    with torch.no_grad():
        for parameter in made.policy.parameters():
            parameter += 1.0
    for (weights, bias), old, old_bias in zip(policy.layers, before, biases, strict=True):
        np.testing.assert_array_equal(weights, old)
        np.testing.assert_array_equal(bias, old_bias)


def test_history_is_exported_if_the_card_has_it() -> None:
    around = SB3VecEnv(make_wrapped_vec(2, [HISTORY], autoreset_mode="SameStep"))
    made = model("ppo", around)
    policy = export(made, history=3, history_actions=2)
    observed = observations(116)
    assert_allclose(policy.forward(observed), made.predict(observed, deterministic=True)[0], atol=1e-5)
    assert_refused(lambda: export(made), "must take 36 or 27 numbers, .* not 116", ValueError)


class TenfoldExtractor(FlattenExtractor):
    """A features extractor that changes the observation."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return 10.0 * super().forward(observations)


class ImageEnv(gym.Env[Any, Any]):
    observation_space = gym.spaces.Box(0, 255, (36, 36, 1), np.uint8)
    action_space = gym.spaces.Box(-1.0, 1.0, (4,))


class WideActionEnv(gym.Env[Any, Any]):
    observation_space = gym.spaces.Box(-1.0, 1.0, (36,))
    action_space = gym.spaces.Box(-2.0, 2.0, (4,))


REFUSED: dict[str, tuple[Any, str]] = {
    "silu": (
        lambda: model("ppo", activation_fn=torch.nn.SiLU),
        "must have linear layers with relu, tanh or elu",
    ),
    "leaky relu": (lambda: model("sac", activation_fn=torch.nn.LeakyReLU), "must have linear layers"),
    "features extractor": (
        lambda: model("ppo", features_extractor_class=TenfoldExtractor),
        "differ from those of its policy network",
    ),
    "images": (
        lambda: PPO("CnnPolicy", ImageEnv(), n_steps=4, batch_size=4, device="cpu"),
        r"PPO with ActorCriticCnnPolicy cannot be exported: it observes numbers of shape \(1, 36, 36\)",
    ),
    "recurrent": (
        lambda: RecurrentPPO("MlpLstmPolicy", env(), n_steps=4, batch_size=8, device="cpu"),
        "RecurrentPPO with RecurrentActorCriticPolicy cannot be exported: it has a memory",
    ),
    "discrete actions": (
        lambda: PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=4, batch_size=4, device="cpu"),
        "last layer must have 4 outputs, not 2",
    ),
    "wider action range": (lambda: model("sac", WideActionEnv()), "differ from those of its policy network"),
    "PPO with a squashed output": (
        lambda: model("ppo", gain=300.0, sde=True, squash_output=True),
        "differ from those of its policy network",
    ),
}


@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU")
@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_models_that_are_more_than_a_network_are_refused(make: Any, message: str) -> None:
    assert_refused(lambda: export(make()), message, ValueError)


@algorithms
def test_saved_model_is_exported(algo: str, tmp_path: Path) -> None:
    made = model(algo)
    made.save(tmp_path / "model.zip")
    assert type(read_zip(tmp_path / "model.zip")) is KINDS[algo][0]
    policy = export_zip(tmp_path / "model.zip", source="me")
    assert policy.card["source"] == "me"
    assert weight_difference(policy, export(made)) == 0.0


def test_files_that_are_not_models_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    assert_refused(lambda: export_zip(path), "is not a model saved by Stable-Baselines3", ValueError)
    path.write_bytes(b"weights")
    assert_refused(lambda: export_zip(path), "model.zip is not a model saved by Stable-Baselines3", ValueError)
    for data in ("[]", "{", json.dumps({"policy_class": 3})):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("data", data)
        assert_refused(lambda: export_zip(path), "is not a model saved by Stable-Baselines3", ValueError)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {"__module__": "stable_baselines3.common.policies"}}))
    assert_refused(lambda: export_zip(path), "model.zip is not a model of PPO", ValueError)
    made = model("ppo")
    made.save(path)
    whole = path.read_bytes()
    for i in range(10, len(whole), len(whole) // 12):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :])
        try:
            policy = export_zip(path)
        except ValueError:
            continue
        assert weight_difference(policy, export(made)) == 0.0
