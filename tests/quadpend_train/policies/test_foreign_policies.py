"""Models of any algorithm, torch modules and ONNX files become policies that act like them."""

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from sb3_contrib import ARS, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.evaluation.comparison import named_policies
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.policies.conversion import as_policy
from quadpend_train.policies.export import ModelPolicy, export, export_zip
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.policies.loading import load_policy, policy_fingerprint
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.policies.network_policy import NetworkPolicy
from quadpend_train.policies.torch_policy import policy_from_torch
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import make_vec
from tests.helpers.own_code import write_module
from tests.helpers.policies import BANDWIDTH_SCHEDULING, mlp_policy

OBSERVATIONS = np.random.default_rng(1).normal(size=(50, 36)).astype(np.float32)
ROLLOUT = {"n_steps": 4, "batch_size": 8}


def small(**options: Any) -> dict[str, Any]:
    """Options of a policy, in a new dictionary, since Stable-Baselines3 changes it."""
    return {"net_arch": [8, 6], **options}


def env() -> SB3VecEnv:
    return SB3VecEnv(make_vec(2, autoreset_mode="SameStep"))


def assert_acts_like(policy: Any, expected: Floats32) -> None:
    assert_allclose(policy.predict(OBSERVATIONS)[0], expected, atol=1e-6)
    assert_allclose(policy.predict(OBSERVATIONS[7])[0], expected[7], atol=1e-6)
    assert policy.predict(OBSERVATIONS)[0].dtype == np.float32


class Wave(nn.Module):
    """A network that is no sequence of layers."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(36, 4)
        self.dropout = nn.Dropout(0.5)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return 2.0 * torch.sin(self.dropout(self.layer(observation)))


@pytest.mark.parametrize(
    ("kind", "options", "exported"),
    [
        (A2C, {"policy_kwargs": small()}, MlpPolicy),
        (TRPO, {"policy_kwargs": small(), **ROLLOUT}, MlpPolicy),
        (TD3, {"policy_kwargs": small(), "buffer_size": 8}, MlpPolicy),
        (DDPG, {"policy_kwargs": small(), "buffer_size": 8}, MlpPolicy),
        (ARS, {"policy_kwargs": small()}, MlpPolicy),
        (CrossQ, {"policy_kwargs": small(), "buffer_size": 8}, ModelPolicy),
        (PPO, {"policy_kwargs": small(activation_fn=nn.SiLU), **ROLLOUT}, ModelPolicy),
    ],
    ids=["A2C", "TRPO", "TD3", "DDPG", "ARS", "CrossQ", "SiLU"],
)
def test_models_of_every_algorithm_fly(kind: Any, options: Any, exported: Any, tmp_path: Path) -> None:
    """They are converted if possible; otherwise the model itself is run."""
    model = kind("MlpPolicy", env(), seed=0, device="cpu", **options)
    model.save(tmp_path / "model.zip")
    expected = model.predict(OBSERVATIONS, deterministic=True)[0]
    for policy in (as_policy(model), load_policy(str(tmp_path / "model.zip"))):
        assert type(policy) is exported
        assert_acts_like(policy, expected)


def test_recurrent_model_flies_with_its_state_as_memory(tmp_path: Path) -> None:
    model = RecurrentPPO("MlpLstmPolicy", env(), policy_kwargs={"lstm_hidden_size": 4}, device="cpu", **ROLLOUT)
    model.save(tmp_path / "model.zip")
    policy: Any = load_policy(str(tmp_path / "model.zip"))
    expected, state = model.predict(OBSERVATIONS, deterministic=True)
    first, memory = policy.predict(OBSERVATIONS)
    assert_array_equal(first, expected)
    started = np.arange(50) < 20
    second, _ = policy.predict(OBSERVATIONS, memory, started)
    assert_array_equal(second, model.predict(OBSERVATIONS, state, started, deterministic=True)[0])
    assert_array_equal(second[:20], first[:20])
    assert (second[20:] != first[20:]).any(axis=1).all()
    assert_refused(lambda: export_zip(tmp_path / "model.zip"), "model.zip: RecurrentPPO .* has a memory", ValueError)


class Images(gym.Env[Any, Any]):
    observation_space = gym.spaces.Box(0, 255, (36, 36, 1), np.uint8)
    action_space = gym.spaces.Box(-1.0, 1.0, (4,))


class Mixed(gym.Env[Any, Any]):
    observation_space = gym.spaces.Dict({"a": gym.spaces.Box(-1.0, 1.0, (3,))})
    action_space = gym.spaces.Box(-1.0, 1.0, (4,))


@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PPO("CnnPolicy", Images(), device="cpu", n_steps=4, batch_size=4), "PPO with ActorCriticCnnPolicy"),
        (
            lambda: PPO("MultiInputPolicy", Mixed(), device="cpu", n_steps=4, batch_size=4),
            "PPO with MultiInput.* observes .*Dict",
        ),
        (lambda: DQN("MlpPolicy", gym.make("CartPole-v1"), buffer_size=8), "DQN"),
    ],
    ids=["images", "several inputs", "another environment"],
)
def test_error_about_a_zip_names_the_file_and_the_policy(make: Any, message: str, tmp_path: Path) -> None:
    make().save(tmp_path / "theirs.zip")
    for load in (export_zip, load_policy):
        assert_refused(lambda load=load: load(str(tmp_path / "theirs.zip")), f"theirs.zip: .*{message}", ValueError)


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any, VecNormalize]:
    """A run folder like those of RL Baselines3 Zoo, its model, and its statistics."""
    folder = tmp_path_factory.mktemp("logs") / "QuadPendulum-v0_1"
    (folder / "QuadPendulum-v0").mkdir(parents=True)
    normalized = VecNormalize(env(), clip_obs=2.0)
    model = PPO("MlpPolicy", normalized, policy_kwargs=small(), seed=0, device="cpu", n_steps=128, batch_size=256)
    model.learn(256)
    model.save(folder / "QuadPendulum-v0.zip")
    normalized.save(str(folder / "QuadPendulum-v0/vecnormalize.pkl"))
    return folder, model, normalized


def test_normalised_observations_are_part_of_the_policy(zoo: Any, tmp_path: Path) -> None:
    """Also where an observation is clipped, and after the policy was saved and loaded."""
    folder, model, normalized = zoo
    observed = [normalized.venv.reset()]
    for _ in range(100):
        action, _ = model.predict(normalized.normalize_obs(observed[-1]), deterministic=True)
        observed.append(normalized.venv.step(action)[0])
    rows = np.concatenate(observed)
    inputs = normalized.normalize_obs(rows)
    assert (np.abs(inputs) == 2.0).any()
    expected, _ = model.predict(inputs, deterministic=True)
    (statistics := tmp_path / "statistics.pkl").write_bytes((folder / "QuadPendulum-v0/vecnormalize.pkl").read_bytes())
    (zipped := tmp_path / "model.zip").write_bytes((folder / "QuadPendulum-v0.zip").read_bytes())
    main(["export", str(zipped), "--vec-normalize", str(statistics), "--out", str(tmp_path / "policy.npz")])
    for policy in (export(model), load_policy(str(folder)), MlpPolicy.load(tmp_path / "policy.npz")):
        assert isinstance(policy, MlpPolicy)
        assert_allclose(policy.predict(rows)[0], expected, atol=1e-6)


def test_model_without_its_statistics_is_refused(zoo: Any, tmp_path: Path) -> None:
    """A model saves an original and the last observation, which show that observations were normalised."""
    folder, model, _ = zoo
    lost = tmp_path / "lost.zip"
    lost.write_bytes((folder / "QuadPendulum-v0.zip").read_bytes())
    for load in (export_zip, load_policy):
        assert_refused(lambda load=load: load(str(lost)), "lost.zip: the model was trained with normalised", ValueError)
    before = policy_fingerprint(str(lost))
    (tmp_path / "vecnormalize.pkl").write_bytes((folder / "QuadPendulum-v0/vecnormalize.pkl").read_bytes())
    load_policy(str(lost))
    assert policy_fingerprint(str(lost)) != before
    (tmp_path / "vecnormalize.pkl").write_bytes(b"nonsense")
    assert_refused(lambda: load_policy(str(lost)), "vecnormalize.pkl is not a file saved by VecNormalize", ValueError)
    assert_refused(
        lambda: export(model, vec_normalize=3), "vec_normalize must be a VecNormalize .* not int", ValueError
    )
    other = VecNormalize(gym_vec_env())
    assert_refused(lambda: export(model, vec_normalize=other), "must have statistics of 36 numbers", ValueError)


def gym_vec_env() -> Any:
    from stable_baselines3.common.vec_env import DummyVecEnv

    return DummyVecEnv([lambda: gym.make("CartPole-v1")])


@pytest.mark.parametrize(("kind", "options"), [(PPO, ROLLOUT), (SAC, {"buffer_size": 8})], ids=["PPO", "SAC"])
def test_model_with_normalised_rewards_only_needs_no_statistics(kind: Any, options: Any) -> None:
    normalized = VecNormalize(env(), norm_obs=False)
    model = kind("MlpPolicy", normalized, policy_kwargs=small(), device="cpu", **options).learn(8)
    assert "normalization" not in export(model).card
    model.env = None
    assert "normalization" not in export(model).card


@pytest.mark.parametrize("squash", [[], [nn.Tanh()], [nn.Hardtanh(-0.5, 0.5)]], ids=["", "tanh", "limit"])
def test_sequence_of_layers_becomes_an_mlp_policy(squash: Any, tmp_path: Path) -> None:
    torch.manual_seed(0)
    module = nn.Sequential(
        nn.Linear(36, 8), nn.ELU(), nn.Sequential(nn.Linear(8, 6, bias=False), nn.ELU()), nn.Linear(6, 4), *squash
    )
    with torch.no_grad():
        module[3].weight *= 10.0
        expected = module(torch.as_tensor(OBSERVATIONS)).clamp(-1.0, 1.0).numpy()
    policy = policy_from_torch(module)
    assert isinstance(policy, MlpPolicy)
    assert_acts_like(policy, expected)
    policy.save(tmp_path / "policy.npz")
    with torch.no_grad():
        module[0].weight.zero_()
    assert_acts_like(MlpPolicy.load(tmp_path / "policy.npz"), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_other_module_is_run(dtype: torch.dtype) -> None:
    """In evaluation mode, and the module of the user is not changed."""
    torch.manual_seed(0)
    module = Wave().to(dtype)
    policy = as_policy(module)
    assert isinstance(policy, NetworkPolicy)
    assert module.training
    expected = 2.0 * torch.sin(module.layer(torch.as_tensor(OBSERVATIONS, dtype=dtype))).clamp(-0.5, 0.5)
    assert_acts_like(policy, expected.detach().to(torch.float32).numpy())
    assert isinstance(adapt_policy(policy, Scenario(output_feedback=True)), FiniteDifferencePolicy)
    assert_refused(lambda: policy.predict(OBSERVATIONS[:, :27]), "takes observations of 36 numbers", ValueError)


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (nn.Linear(30, 4), "first layer must take 36 or 27 numbers"),
        (nn.Linear(36, 3), "last layer must have 4 outputs|returned shape"),
        (nn.LSTM(36, 4), "module LSTM must map"),
    ],
    ids=["inputs", "outputs", "memory"],
)
def test_module_of_another_shape_is_refused(module: Any, message: str) -> None:
    assert_refused(lambda: policy_from_torch(module), message, ValueError)
    assert_refused(lambda: as_policy(3), "a policy must be an object with predict", TypeError)


def onnx_file(path: Path, rows: int | str = "n", columns: int = 36) -> Floats32:
    """Write a model of one layer without limits, and return the weights."""
    helper = pytest.importorskip("onnx", reason="onnx is not installed").helper
    numbers = pytest.importorskip("onnx").TensorProto.FLOAT
    weights = np.random.default_rng(0).normal(size=(columns, 4), scale=0.2).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", numbers, [rows, columns])],
        [helper.make_tensor_value_info("action", numbers, [rows, 4])],
        [helper.make_tensor("weights", numbers, weights.shape, weights.ravel())],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(made.SerializeToString())
    return weights


@pytest.mark.parametrize("rows", ["n", 1], ids=["any number of rows", "one row"])
def test_onnx_file_is_a_policy(rows: Any, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install 'quadpend-gym[onnx]'")
    weights = onnx_file(tmp_path / "policy.onnx", rows)
    policy = load_policy(str(tmp_path / "policy.onnx"))
    assert_acts_like(policy, np.clip(OBSERVATIONS @ weights, -1.0, 1.0))
    assert_array_equal(policy.predict(OBSERVATIONS)[0], policy.predict(OBSERVATIONS)[0])


def test_bad_onnx_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install 'quadpend-gym[onnx]'")
    path = tmp_path / "policy.onnx"
    onnx_file(path, columns=30)
    assert_refused(lambda: load_policy(str(path)), "policy.onnx must map observations of shape", ValueError)
    path.write_bytes(b"nonsense")
    assert_refused(lambda: load_policy(str(path)), "policy.onnx is not an ONNX model", ValueError)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert_refused(lambda: load_policy(str(path)), r"needs onnxruntime: pip install 'quadpend-gym\[onnx\]'", ValueError)


def test_object_with_predict_is_a_policy_already() -> None:
    policy = mlp_policy(45, hybrid=BANDWIDTH_SCHEDULING)
    assert as_policy(policy) is policy


def test_factories_and_comparisons_take_torch_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "from torch import nn\n\ndef make():\n    return nn.Linear(36, 4)\n\ndef wrong():\n    return nn.Linear(3, 4)\n"
    )
    module = write_module(tmp_path, monkeypatch, code)
    assert isinstance(load_policy(f"{module}:make"), MlpPolicy)
    assert_refused(lambda: load_policy(f"{module}:wrong"), f"{module}:wrong: the first layer must take 36", ValueError)
    ((policy,),) = named_policies([nn.Linear(36, 4)]).values()
    assert isinstance(policy, MlpPolicy)
