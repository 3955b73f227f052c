"""Models of any algorithm and torch modules become policies that act like them, or are refused with a reason."""

from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from sb3_contrib import ARS, TQC, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train.cli.main import main
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.conversion import FunctionPolicy, as_policy
from quadpend_train.policies.from_sb3 import export, export_zip, read_layers
from quadpend_train.policies.loading import load_policy, policy_fingerprint
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.policies.normalization import statistics_files
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, linear_layers, read_zip
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import make_vec
from tests.helpers.own_code import write_module
from tests.helpers.policies import RESIDUAL_ACTION, mlp_policy

OBSERVATIONS = np.random.default_rng(1).normal(size=(50, 36)).astype(np.float32)
ROLLOUT, BUFFER = {"n_steps": 4, "batch_size": 8}, {"buffer_size": 8}
OPTIONS: dict[Any, dict[str, Any]] = {
    **dict.fromkeys((PPO, TRPO), ROLLOUT),
    **dict.fromkeys((SAC, TQC, TD3, DDPG, CrossQ), BUFFER),
    A2C: {},
    ARS: {},
}


def env() -> SB3VecEnv:
    return SB3VecEnv(make_vec(2, autoreset_mode="SameStep"))


def model(kind: Any, around: Any = None, gain: float = 1.0, sde: bool = False, **policy: Any) -> Any:
    """An untrained model whose last weights are `gain` times as large."""
    more = {**OPTIONS[kind], **({"use_sde": True} if sde else {})}
    policy = {"net_arch": [8, 6], **policy}
    made = kind("MlpPolicy", around or env(), policy_kwargs=policy, seed=0, device="cpu", **more)
    if gain != 1.0:
        with torch.no_grad():
            for parameter in linear_layers(made)[-1].parameters():
                parameter *= gain
    return made


@pytest.mark.parametrize("observation", ["full", "lab", ["direction", "position"]])
def test_a_model_of_stacked_observations_flies_without_their_wrapper(observation: Any, tmp_path: Path) -> None:
    options: dict[str, Any] = {"autoreset_mode": "SameStep", "observation": observation}
    around = SB3VecEnv(VectorHistoryWrapper(make_vec(2, **options), 3, 2))
    made = model(PPO, around)
    made.save(tmp_path / "model.zip")
    policy, stacked, plain = (
        load_policy(str(tmp_path / "model.zip")),
        around.env,
        make_vec(2, **options),
    )
    seen, measured, memory = stacked.reset(seed=0)[0], plain.reset(seed=0)[0], None
    for step in range(20):
        action, memory = policy.predict(measured, memory, np.full(2, step == 0))
        assert_allclose(action, made.predict(seen, deterministic=True)[0], atol=1e-5)
        seen, measured = stacked.step(action)[0], plain.step(action)[0]
    with pytest.raises(ValueError, match="takes 108 numbers, not 36 or 27"):  # nothing says how it was stacked
        mlp_policy(108)


def assert_acts_like(policy: Any, expected: Floats32) -> None:
    action = policy.predict(OBSERVATIONS)[0]
    assert action.dtype == np.float32
    assert_allclose(action, expected, atol=1e-5)
    assert_allclose(policy.predict(OBSERVATIONS[7])[0], expected[7], atol=1e-5)


def acts(made: Any) -> Any:
    return made.predict(OBSERVATIONS, deterministic=True)[0]


class TenfoldExtractor(FlattenExtractor):
    """A features extractor that changes the observation."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return 10.0 * super().forward(observations)


SILU: dict[str, Any] = {"activation_fn": nn.SiLU}
FEATURES: dict[str, Any] = {"features_extractor_class": TenfoldExtractor}
SCALES = {"features_extractor_class": MultiScaleInputs, "features_extractor_kwargs": {"scales": (3.0, 20.0)}}
CONVERTED: list[Any] = [
    {},
    *({"activation_fn": kind} for kind in ACTIVATION_MODULES.values()),
    {"net_arch": []},
    SCALES,
]


@pytest.mark.parametrize(
    ("kind", "policy"),
    [*((kind, {}) for kind in OPTIONS), *product((PPO, SAC), CONVERTED[1:]), (PPO, SILU), (PPO, FEATURES)],
    ids=lambda item: item.__name__ if isinstance(item, type) else None,
)
def test_models_of_every_algorithm_fly(kind: Any, policy: Any, tmp_path: Path) -> None:
    """They are converted if possible; otherwise the model itself is run."""
    made = model(kind, **policy)
    made.save(tmp_path / "model.zip")
    with_their_policies = {DDPG: TD3, A2C: PPO, TRPO: PPO}
    assert type(read_zip(tmp_path / "model.zip")) is with_their_policies.get(kind, kind)
    for loaded in (as_policy(made), load_policy(str(tmp_path / "model.zip"))):
        assert isinstance(loaded, MlpPolicy) == (policy in CONVERTED and kind is not CrossQ)
        assert_acts_like(loaded, acts(made))


@pytest.mark.parametrize("sde", [False, True], ids=["", "gSDE"])
@pytest.mark.parametrize(("kind", "gain"), [(PPO, 300.0), (SAC, 60.0), (TQC, 60.0)])
def test_large_actions_are_limited_like_those_of_the_model(kind: Any, gain: float, sde: bool) -> None:
    """PPO clips actions; SAC and TQC squash them by a tanh, and with gSDE clip them before that."""
    made = model(kind, gain=gain, sde=sde)
    assert np.mean(np.abs(acts(made)) > 0.95) > 0.2
    assert_acts_like(export(made), acts(made))


def test_recurrent_model_flies_with_its_state_as_memory(tmp_path: Path) -> None:
    made = RecurrentPPO("MlpLstmPolicy", env(), policy_kwargs={"lstm_hidden_size": 4}, device="cpu", **ROLLOUT)
    made.save(tmp_path / "model.zip")
    policy = load_policy(str(tmp_path / "model.zip"))
    expected, state = made.predict(OBSERVATIONS, deterministic=True)
    first, memory = policy.predict(OBSERVATIONS)
    assert_array_equal(first, expected)
    started = np.arange(50) < 20
    second, _ = policy.predict(OBSERVATIONS, memory, started)
    assert_array_equal(second, made.predict(OBSERVATIONS, state, started, deterministic=True)[0])
    assert_refused(lambda: export_zip(tmp_path / "model.zip"), "model.zip: .* is not a feedforward network", ValueError)


def test_algorithm_of_another_library_flies_by_its_own_predict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of SBX: it is found beside its class of policies."""
    code = (
        "import numpy as np\nfrom stable_baselines3 import PPO\nfrom stable_baselines3.ppo import MlpPolicy as Base\n"
        "class TheirPolicy(Base):\n    pass\n"
        "class TheirAlgorithm(PPO):\n    def predict(self, observation, *_, **__):\n"
        "        return np.full((len(observation), 4), 0.25, np.float32), None\n"
    )
    name = write_module(tmp_path, monkeypatch, code)
    monkeypatch.syspath_prepend(tmp_path)
    module = __import__(name)
    module.TheirAlgorithm(module.TheirPolicy, env(), device="cpu", **ROLLOUT).save(tmp_path / "model.zip")
    policy: Any = load_policy(str(tmp_path / "model.zip"))
    assert (policy.predict(OBSERVATIONS)[0] == 0.25).all()


class WideActions(gym.Env[Any, Any]):
    observation_space = gym.spaces.Box(-1.0, 1.0, (36,))
    action_space = gym.spaces.Box(-2.0, 2.0, (4,))


@pytest.mark.filterwarnings("ignore:You are trying to run PPO on the GPU")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DQN("MlpPolicy", gym.make("CartPole-v1"), buffer_size=8), ": .*(not a feedforward|acts in Discrete)"),
        (lambda: model(SAC, WideActions()), r": .*(differ from those|acts in Box\(-2.0)"),
    ],
    ids=["another environment", "a wider range of actions"],
)
def test_models_of_something_else_are_refused(make: Any, message: str, tmp_path: Path) -> None:
    make().save(tmp_path / "theirs.zip")
    for load in (export_zip, load_policy):
        assert_refused(lambda load=load: load(str(tmp_path / "theirs.zip")), f"theirs.zip{message}", ValueError)


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any, VecNormalize]:
    """A run folder like those of RL Baselines3 Zoo, its model, and its statistics."""
    folder = tmp_path_factory.mktemp("logs") / "QuadPendulum-v0_1"
    (folder / "QuadPendulum-v0").mkdir(parents=True)
    normalized = VecNormalize(env(), clip_obs=2.0)
    made = PPO("MlpPolicy", normalized, policy_kwargs={"net_arch": [8]}, seed=0, device="cpu", n_steps=128)
    made.learn(256)
    made.save(folder / "QuadPendulum-v0.zip")
    normalized.save(str(folder / "QuadPendulum-v0/vecnormalize.pkl"))
    return folder, made, normalized


def test_normalised_observations_are_part_of_the_policy(zoo: Any, tmp_path: Path) -> None:
    """Also where an observation is clipped, and after the policy was saved and loaded."""
    folder, made, normalized = zoo
    rows = normalized.unnormalize_obs(np.random.default_rng(0).normal(size=(50, 36), scale=2.0)).astype(np.float32)
    inputs = normalized.normalize_obs(rows)
    assert (np.abs(inputs) == 2.0).any()
    expected, _ = made.predict(inputs, deterministic=True)
    (statistics := tmp_path / "statistics.pkl").write_bytes((folder / "QuadPendulum-v0/vecnormalize.pkl").read_bytes())
    (zipped := tmp_path / "model.zip").write_bytes((folder / "QuadPendulum-v0.zip").read_bytes())
    main(["export", str(zipped), "--vec-normalize", str(statistics), "--out", str(tmp_path / "policy.npz")])
    for policy in (export(made), load_policy(str(folder)), MlpPolicy.load(tmp_path / "policy.npz")):
        assert_allclose(policy.predict(rows)[0], expected, atol=1e-6)


def test_the_statistics_beside_a_model_belong_to_the_policy(zoo: Any, tmp_path: Path) -> None:
    folder, _, _ = zoo
    (lost := tmp_path / "lost.zip").write_bytes((folder / "QuadPendulum-v0.zip").read_bytes())
    before = policy_fingerprint(str(lost))
    (tmp_path / "vecnormalize.pkl").write_bytes((folder / "QuadPendulum-v0/vecnormalize.pkl").read_bytes())
    assert load_policy(str(lost)).fingerprint == policy_fingerprint(str(lost)) != before
    (tmp_path / "vecnormalize.pkl").write_bytes(b"nonsense")
    assert_refused(lambda: load_policy(str(lost)), "vecnormalize.pkl is not a VecNormalize", ValueError)


@pytest.mark.parametrize(
    ("model", "statistics", "is_found"),
    [
        ("ppo.zip", "vec_normalize.pkl", True),
        ("ppo.zip", "vecnormalize.pkl", True),
        ("my_run_800_steps.zip", "my_run_vecnormalize_800_steps.pkl", True),
        ("QuadPendulum-v0_1/best_model.zip", "QuadPendulum-v0_1/QuadPendulum-v0/vecnormalize.pkl", True),
        ("renamed/QuadPendulum-v0.zip", "renamed/QuadPendulum-v0/vecnormalize.pkl", True),
        ("ppo.zip", "run2/vecnormalize.pkl", False),
        ("my_run_800_steps.zip", "my_run_vecnormalize_900_steps.pkl", False),
        ("my_run_800_steps.zip", "other_vecnormalize_800_steps.pkl", False),
        ("ppo.zip", "my_run_vecnormalize_800_steps.pkl", False),
    ],
)
def test_statistics_are_found_by_their_usual_names_and_no_others(
    model: str, statistics: str, is_found: bool, tmp_path: Path
) -> None:
    (tmp_path / statistics).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / statistics).write_bytes(b"")
    assert statistics_files(tmp_path / model) == [tmp_path / statistics] * is_found


def test_statistics_are_applied_if_and_only_if_the_model_was_trained_with_them(
    zoo: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (lost := tmp_path / "lost.zip").write_bytes((zoo[0] / "QuadPendulum-v0.zip").read_bytes())
    assert load_policy(str(lost)).card.get("normalization") is None
    assert "lost.zip: was trained with VecNormalize; if that normalised observations, put" in capsys.readouterr().err
    statistics = (zoo[0] / "QuadPendulum-v0/vecnormalize.pkl").read_bytes()
    (tmp_path / "vec_normalize.pkl").write_bytes(statistics)
    assert load_policy(str(tmp_path)).card["normalization"]["clip"] == 2.0
    assert "lost.zip: observations are normalised by" in capsys.readouterr().err
    PPO("MlpPolicy", env(), device="cpu", **ROLLOUT).learn(8).save(plain := tmp_path / "plain.zip")
    assert load_policy(str(plain)).card.get("normalization") is None
    assert "plain.zip: was trained without VecNormalize: " in capsys.readouterr().err
    (tmp_path / "vecnormalize.pkl").write_bytes(statistics + b" ")
    assert_refused(lambda: load_policy(str(lost)), "lost.zip: .* in .* and .*: keep one of them", ValueError)
    assert_refused(lambda: load_policy(str(tmp_path)), "one of the models in .*: lost.zip, plain.zip", ValueError)


def test_an_off_policy_model_does_not_tell_whether_it_was_normalised(
    zoo: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    SAC("MlpPolicy", env(), device="cpu", learning_starts=2, **BUFFER).learn(8).save(path := tmp_path / "model.zip")
    assert load_policy(str(path)).card.get("normalization") is None
    assert capsys.readouterr().err == ""
    (tmp_path / "vecnormalize.pkl").write_bytes((zoo[0] / "QuadPendulum-v0/vecnormalize.pkl").read_bytes())
    assert load_policy(str(path)).card["normalization"]["clip"] == 2.0
    assert "vecnormalize.pkl; if it was trained without, move that away" in capsys.readouterr().err


def test_a_model_that_was_trained_on_several_vehicles_flies_any(tmp_path: Path) -> None:
    scenarios = [Scenario(vehicle=name, interface="body_rates") for name in ("hummingbird", "crazyflie")]
    around = SB3VecEnv(ConcatenatedVectorEnv([scenario.make_vec(1) for scenario in scenarios]))
    PPO("MlpPolicy", around, device="cpu", **ROLLOUT).save(path := tmp_path / "model.zip")
    policy = load_policy(str(path))
    assert (policy.card["interface"], policy.card["vehicle"]) == ("body_rates", "any")
    for scenario in scenarios:
        policy.adapt(scenario)


@pytest.mark.parametrize("kind", [PPO, RecurrentPPO])
def test_a_model_says_which_fields_it_reads(kind: Any, tmp_path: Path) -> None:
    fields = ("attitude", "tracking_error")
    around = SB3VecEnv(Scenario(observation=fields).make_vec(2))  # type: ignore[arg-type]
    name = "MlpLstmPolicy" if kind is RecurrentPPO else "MlpPolicy"
    kind(name, around, device="cpu", **ROLLOUT).save(path := tmp_path / "model.zip")
    policy, scenario = load_policy(str(path)), Scenario()
    assert policy.layouts == (fields,)
    observation = scenario.make_vec(2).reset(seed=0)[0]
    action = policy.adapt(scenario).predict(observation)[0]
    assert_array_equal(action, policy.predict(observation[:, [12, 13, 14, 0, 1, 2]])[0])


@pytest.mark.parametrize("kind", [PPO, RecurrentPPO])
def test_a_model_is_refused_where_its_actions_mean_something_else(kind: Any, tmp_path: Path) -> None:
    rates = Scenario(vehicle="hummingbird", interface="body_rates")
    for scenario, other in ((Scenario(vehicle="hummingbird"), rates), (rates, Scenario(vehicle="hummingbird"))):
        around = VecNormalize(SB3VecEnv(scenario.make_vec(2)))
        name = "MlpLstmPolicy" if kind is RecurrentPPO else "MlpPolicy"
        kind(name, around, device="cpu", **ROLLOUT).save(path := tmp_path / "model.zip")
        policy = load_policy(str(path))
        policy.adapt(scenario)
        assert_refused(lambda policy=policy, other=other: policy.adapt(other), "trained with the interface", ValueError)


def test_the_network_of_a_hybrid_does_not_fly_alone(tmp_path: Path) -> None:
    hybrid = VectorHybridWrapper(make_vec(2, autoreset_mode="SameStep"), RESIDUAL_ACTION)
    PPO("MlpPolicy", SB3VecEnv(hybrid), device="cpu", **ROLLOUT).save(path := tmp_path / "model.zip")
    for load in (export_zip, load_policy):
        assert_refused(lambda load=load: load(str(path)), "is the network of a hybrid .ResidualAction", ValueError)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.zip", b"", "is not a model saved by Stable-Baselines3"),
        ("ppo.cleanrl_model", b"PK", "is neither a policy file .* weights of torch, as of CleanRL"),
        ("policy.pth", b"PK", "is neither a policy file"),
        ("user/ppo-QuadPendulum-v0", None, "no policy .*: this file or folder is not on this machine"),
        ("missing.zip", None, "no policy 'missing.zip': this file"),
        (".", None, "folder '.' has neither policy.npz nor a model"),
    ],
)
def test_other_files_are_refused_in_one_sentence(
    name: str, content: bytes | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(name).write_bytes(content)
    assert_refused(lambda: load_policy(name), message, ValueError)


@pytest.mark.parametrize("squash", [[], [nn.Tanh()]], ids=["", "tanh"])
def test_sequence_of_layers_becomes_an_mlp_policy(squash: Any) -> None:
    torch.manual_seed(0)
    module = nn.Sequential(
        nn.Linear(36, 8), nn.ELU(), nn.Sequential(nn.Linear(8, 6, bias=False), nn.ELU()), nn.Linear(6, 4), *squash
    )
    with torch.no_grad():
        module[3].weight *= 10.0
        expected = module(torch.as_tensor(OBSERVATIONS)).clamp(-1.0, 1.0).numpy()
    found, fields = read_layers([module])
    assert_acts_like(MlpPolicy(found, {"format": FORMAT, **fields, "hybrid": None}), expected)
    assert_acts_like(FunctionPolicy(lambda rows: module(torch.as_tensor(rows)).detach()), expected)
    assert_refused(lambda: read_layers([nn.LSTM(36, 4)]), "must have linear layers", ValueError)
