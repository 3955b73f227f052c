"""Training settings: files change the defaults, tables pass through to the algorithms, and errors name the setting."""

import inspect
import json
from pathlib import Path
from typing import Any

import pytest
import torch

from quadpend_gym import OrnsteinUhlenbeck, RewardWeights
from quadpend_gym.scenarios import SETS, Scenario
from quadpend_train.policies.sb3_models import algorithm_class
from quadpend_train.training.algorithms import make_model
from quadpend_train.training.arguments import as_python
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import (
    PRESETS,
    ApgSettings,
    HybridSettings,
    TrainSettings,
    from_mapping,
    read_settings,
    to_mapping,
    with_values,
)
from tests.helpers.own_code import write_module
from tests.helpers.policies import mlp_policy
from tests.helpers.training import BRIEF, train_policy

EVERYTHING = TrainSettings(
    algo="tqc",
    scenarios=("training", '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'),
    num_envs=9,
    hybrid=HybridSettings("flatness", "residual_action", action_scale=0.5),
    reward=RewardWeights(tip=0.1),
    eval_freq=100,
    arguments={"tau": 0.1, "learning_rate": {"initial": 1e-3, "final": 1e-5}, "policy_kwargs": {"net_arch": (32,)}},
)


@pytest.mark.parametrize(
    "settings",
    [TrainSettings(), EVERYTHING, TrainSettings(algo="apg", apg=ApgSettings(net_arch=(8,)))],
    ids=["defaults", "everything", "apg"],
)
def test_settings_survive_json_and_the_card_of_a_policy(settings: TrainSettings, tmp_path: Path) -> None:
    data = json.loads(json.dumps(to_mapping(settings)))
    assert from_mapping(data, "JSON") == settings
    mlp_policy(36, settings=data).save(tmp_path / "policy.npz")
    assert read_settings(str(tmp_path / "policy.npz")) == settings


@pytest.mark.parametrize("path", sorted(PRESETS.glob("*.toml")), ids=lambda path: path.stem)
def test_presets_are_valid_and_use_no_held_out_scenario(path: Path) -> None:
    settings = read_settings(path.stem)
    assert settings == read_settings(str(path))
    assert not (set(SETS["test"]) - set(SETS["training"])) & {scenario.name for scenario in settings.scenarios}


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
def test_every_argument_of_the_class_may_be_given(algo: str) -> None:
    """But for those that a run sets itself; so a new argument needs no change here."""
    own = {"policy", "env", "seed", "device", "tensorboard_log", "_init_setup_model", "policy_kwargs"}
    parameters = inspect.signature(algorithm_class(algo)).parameters.values()
    given = {item.name: item.default for item in parameters if item.name not in own}
    assert given.items() <= from_mapping({"algo": algo, algo: given}, "a file").arguments.items()


def test_arguments_reach_the_model() -> None:
    settings = with_values(
        BRIEF,
        {
            "ppo.learning_rate": {"initial": 1e-2, "final": 1e-3},
            "ppo.clip_range": 0.3,
            "ppo.vf_coef": 0.7,
            "ppo.policy_kwargs": {"net_arch": {"pi": (8,), "vf": (9,)}, "activation_fn": "elu", "log_std_init": -1.5},
        },
    )
    model = make_model(settings, make_env(settings), None)
    assert [model.lr_schedule(left) for left in (1.0, 0.5, 0.0, -0.1)] == pytest.approx([1e-2, 5.5e-3, 1e-3, 1e-3])
    assert (model.vf_coef, model.clip_range(1.0), model.n_steps) == (0.7, 0.3, 16)
    assert model.policy.log_std.detach().numpy() == pytest.approx(-1.5)
    assert [type(layer) for layer in model.policy.mlp_extractor.policy_net] == [torch.nn.Linear, torch.nn.ELU]
    assert model.policy.mlp_extractor.value_net[0].out_features == 9
    assert as_python({"train_freq": (4, "step")}) == {"train_freq": (4, "step")}


@pytest.mark.parametrize("algo", ["a2c", "trpo", "td3", "ddpg"])
def test_other_algorithms_train_without_a_preset(algo: str, tmp_path: Path) -> None:
    table = {"learning_starts": 64} if algo in ("td3", "ddpg") else {}
    brief = {"scenarios": BRIEF.scenarios, "num_envs": 4, "total_timesteps": 128, "n_eval_episodes": 1}
    policy = train_policy(from_mapping({"algo": algo, algo: table, **brief}, "a test"), tmp_path / "run")
    assert policy.card["settings"]["algo"] == algo


def test_a_file_changes_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        "seed = 7\nscenarios = 'calm'\n[ppo]\nn_epochs = 5\npolicy_kwargs = {log_std_init = -1}\n"
        "[hybrid]\nbase_controller = 'lqr'\n[reward]\ntip = 0.2\n"
    )
    assert read_settings(str(path)) == TrainSettings(
        seed=7,
        scenarios=("calm",),
        arguments={"n_epochs": 5, "policy_kwargs": {"log_std_init": -1}},
        hybrid=HybridSettings("lqr"),
        reward=RewardWeights(tip=0.2),
    )
    assert read_settings(str(path)).arguments["policy_kwargs"]["net_arch"] == (64, 64)


def test_scenarios_may_be_a_name_a_mapping_json_or_a_list_of_these(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('wind = "windy"\n')

    def settings(given: Any) -> TrainSettings:
        return from_mapping({"scenarios": given}, "a test")

    assert settings("training") == settings([*SETS["training"]])
    whole = settings(str(path))
    assert whole.scenarios == (Scenario(wind="windy", vehicle="paper"),)
    path.unlink()  # the settings have the contents of the file
    assert settings(to_mapping(whole)["scenarios"]) == whole
    for given in ('{"wind": "windy"}', {"wind": "windy"}, [{"wind": "windy"}]):
        assert settings(given) == whole


class Mine(OrnsteinUhlenbeck):
    """A wind of the user's own class."""


def test_models_of_own_code_are_kept_by_the_names_of_their_factories_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = write_module(tmp_path, monkeypatch, "from quadpend_gym import Dryden as make")
    own = TrainSettings(scenarios=f"{module}:make")
    assert from_mapping(to_mapping(own), "a test") == own
    with pytest.raises(
        ValueError, match=r"cannot describe Mine\(.*: give the models of a scenario as 'module:factory'"
    ):
        to_mapping(TrainSettings(scenarios=Scenario(wind=Mine())))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sead": 7}, r"mine.toml has no field 'sead' \(did you mean 'seed'\?\)"),
        ({"sac": {"tau": 0.1}}, "mine.toml has no field 'sac'"),
        ({"arguments": {"gamma": 0.9}}, "no field 'arguments': those of the algorithm are in the table of its name"),
        ({"ppo": {"epochs": 7}}, r"ppo has no argument 'epochs' \(did you mean 'n_epochs'\?\); its arg"),
        ({"ppo": {"policy_kwargs": {"net_arh": 1}}}, r"ppo.policy_kwargs has no argument 'net_arh' \(did"),
        ({"ppo": {"policy_kwargs": {"activation_fn": "gelu"}}}, "activation_fn must be one of relu, tanh, elu, not"),
        ({"ppo": 7}, "must be a valid dictionary, not 7"),
        ({"algo": "pqo"}, r"algo must be one of .*, not 'pqo' \(did you mean 'ppo'\?\)"),
        ({"algo": "recurrentppo"}, "no policy with a feedforward network"),
        ({"apg": {"window": 9}}, "the settings in apg are for algo 'apg' only"),
        ({"algo": "sac", "critic_warmup_steps": 9}, "critic_warmup_steps needs an on-policy algorithm"),
        ({"hybrid": {"mode": "residual_action"}}, "a hybrid needs a base_controller"),
        ({"hybrid": {"base_controller": "lqr", "action_repeat": 2}}, "has no field 'action_repeat'"),
        ({"hybrid": {"base_controller": "lqr", "failure_penalty": 3.0}}, "needs baseline_relative_reward"),
        (
            {"hybrid": {"base_controller": "lqr", "mode": "residual_action", "imitation_timesteps": 1}},
            "needs a mode of",
        ),
        ({"scenarios": "test"}, "scenarios cannot be 'test', which is held out"),
        ({"scenarios": ["calm", "storm"]}, "scenarios cannot be 'storm', which is held out"),
        ({"scenarios": {"wind": "storm"}}, "which is held out with 'storm'"),
        ({"scenarios": []}, "scenarios must name at least one scenario"),
        ({"scenarios": ["calm", "windy"], "num_envs": 3}, "num_envs must be a multiple of the number of scenarios, 2"),
        ({"start_from": "x", "hybrid": {"base_controller": "lqr", "imitation_timesteps": 1}}, "must be 0 with start_"),
    ],
    ids=str,
)
def test_invalid_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_mapping(settings, "mine.toml")
