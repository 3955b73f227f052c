"""Training settings: files change the defaults, scenarios are resolved, and errors name the setting."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from quadpend_baselines.hybrid import hybrid_from_data
from quadpend_gym import RewardWeights
from quadpend_gym.scenarios import SETS, expand_sets
from quadpend_train.training.settings import (
    PRESETS,
    HybridSettings,
    PpoSettings,
    SacSettings,
    TrainSettings,
    from_mapping,
    read_settings,
    settings_of_card,
    to_mapping,
)
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import RESIDUAL_ACTION, mlp_policy

EVERYTHING = TrainSettings(
    algo="tqc",
    scenarios=("training", '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'),
    curriculum=("calm", '{"wind": "breeze"}'),
    curriculum_steps=5000,
    num_envs=9,
    hybrid=HybridSettings("flatness", "bandwidth_scheduling", action_scale=0.5),
    history=2,
    net_arch=(32,),
    reward=RewardWeights(tip=0.1),
    eval_freq=100,
    patience=3,
    sac=SacSettings(tau=0.1),
)


@pytest.mark.parametrize("settings", [TrainSettings(), EVERYTHING], ids=["defaults", "everything"])
def test_settings_survive_json(settings: TrainSettings) -> None:
    data = json.loads(json.dumps(to_mapping(settings)))
    assert from_mapping(data, "JSON") == settings
    assert TrainSettings(**data) == settings
    assert hash(from_mapping(data, "JSON")) == hash(settings)
    others = {"ppo": {"sac", "apg"}, "tqc": {"ppo", "apg"}}[settings.algo]
    assert set(data) == {field.name for field in fields(TrainSettings)} - others


@pytest.mark.parametrize("path", sorted(PRESETS.glob("*.toml")), ids=lambda path: path.stem)
def test_presets_are_valid_and_use_no_held_out_scenario(path: Path) -> None:
    assert read_settings(path.stem) == read_settings(str(path))
    held_out = set(SETS["test"]) - set(SETS["training"])
    assert not held_out & set(expand_sets([*read_settings(path.stem).scenarios, *read_settings(path.stem).curriculum]))


def test_files_change_the_defaults_and_errors_name_the_setting(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        "seed = 7\nnet_arch = [32]\n[ppo]\nn_epochs = 5\n[hybrid]\nbase_controller = 'lqr'\n[reward]\ntip = 0.2\n"
    )
    expected = TrainSettings(
        seed=7,
        net_arch=(32,),
        ppo=PpoSettings(n_epochs=5),
        hybrid=HybridSettings("lqr"),
        reward=RewardWeights(tip=0.2),
    )
    assert read_settings(str(path)) == expected
    for text, message in (
        (
            "sead = 7\n",
            "mine.toml sets 'sead', which is not a setting .did you mean 'seed'..; the settings are algo, scenarios",
        ),
        (
            "[ppo]\nepoch = 7\n",
            "mine.toml sets 'epoch', which is not a setting .did you mean 'n_epochs'..; the settings are n_steps",
        ),
        ("[sac]\nn_steps = 7\n", "mine.toml sets 'n_steps', which is not a setting"),
        (
            "[hybrid]\nmodus = 7\n",
            "mine.toml sets 'modus', which is not a setting .did you mean 'mode'..; the settings are base_controller",
        ),
        ("[reward]\nfun = 7\n", "mine.toml sets 'fun', which is not a setting; the settings are tracking"),
        ("ppo = 7\n", "ppo"),
        ("hybrid = 7\n", "hybrid"),
        ("reward = [1, 2]\n", "reward"),
    ):
        path.write_text(text)
        assert_refused(lambda: read_settings(str(path)), message, (ValueError, TypeError))
    assert_refused(lambda: read_settings("nix"), "path of a file or one of apg, fast, .*, not 'nix'", ValueError)


def test_settings_are_read_from_the_card_of_a_policy(tmp_path: Path) -> None:
    mlp_policy(36, settings=to_mapping(EVERYTHING)).save(tmp_path / "policy.npz")
    assert read_settings(str(tmp_path / "policy.npz")) == EVERYTHING
    mlp_policy(36).save(tmp_path / "exported.npz")
    assert_refused(lambda: read_settings(str(tmp_path / "exported.npz")), "exported.npz.* settings", ValueError)
    assert_refused(lambda: read_settings(str(tmp_path / "nix.npz")), "nix.npz", ValueError)


def test_settings_of_another_algorithm_are_refused_and_left_out_of_a_card() -> None:
    for algo, given in (
        ("sac", {"ppo": {"n_epochs": 9}}),
        ("ppo", {"sac": {"tau": 0.1}}),
        ("tqc", {"apg": {"window": 9}}),
    ):
        (table,) = given
        message = f"the settings in {table} are for algo .* only: they must be left out with algo '{algo}'"
        assert_refused(lambda: from_mapping({"algo": algo, **given}, "a test"), message, ValueError)  # noqa: B023
    old = {"settings": {"algo": "sac", "ppo": {"n_epochs": 9}, "sac": {"tau": 0.1}}}
    assert settings_of_card(old, "old") == TrainSettings(algo="sac", sac=SacSettings(tau=0.1))


def test_scenario_may_be_a_name_a_mapping_json_or_a_list_of_these(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('wind = "storm"\n')
    assert TrainSettings(scenarios="calm") == TrainSettings(scenarios=("calm",)) == TrainSettings(scenarios=["calm"])  # type: ignore[arg-type]
    assert TrainSettings(scenarios="training").scenarios == ("training",)  # type: ignore[arg-type]
    given: Any
    (whole,) = TrainSettings(scenarios=(str(path),)).scenarios
    path.unlink()  # the settings have the contents of the file
    for given in ('{"wind": "storm"}', {"wind": "storm"}, [{"wind": "storm"}], whole):
        assert TrainSettings(scenarios=given).scenarios == (whole,)
    assert json.loads(whole)["wind"]


def test_whole_numbers_are_accepted_as_numbers() -> None:
    settings = TrainSettings(hybrid=HybridSettings("flatness", "residual_action", action_scale=1))
    assert settings.policy_interface()["hybrid"] == {**RESIDUAL_ACTION, "action_scale": 1.0, "fallback_gain": 0.0}
    assert isinstance(settings.hybrid.action_scale, float)
    assert mlp_policy(49, **settings.policy_interface())


@pytest.mark.parametrize("mode", ["estimate_only", "residual_action", "bandwidth_scheduling"])
def test_hybrid_settings_describe_a_hybrid(mode: Any) -> None:
    """The data on the card are those of the hybrid itself."""
    data = HybridSettings("flatness", mode, action_scale=0.5).as_data()
    hybrid = hybrid_from_data(data)
    assert hybrid.kind == mode
    assert hybrid.as_data() == data
    assert HybridSettings().as_data() is None


RESIDUAL = {"base_controller": "flatness", "mode": "residual_action"}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"learning_rate": 1e300}, r"learning_rate must be a finite number in \[1e-12, 1e\+06\], not 1e\+300"),
        ({"num_envs": 10**9}, "num_envs must be a whole number from 1 to 100000, not 1000000000"),
        ({"net_arch": (10**9,)}, r"net_arch\[0\] must be a whole number from 1 to 8192, not 1000000000"),
        ({"net_arch": (1,) * 17}, "net_arch must have at most 16 layers, not 17"),
        ({"num_envs": 10**5, "ppo": {"n_steps": 10**5}}, "num_envs \\* ppo.n_steps must be at most 50000000"),
        ({"sac": {"buffer_size": 10**12}, "algo": "sac"}, "buffer_size must be a whole number from 1 to 100000000"),
        ({"num_envs": 1.5}, "num_envs must be a whole number from 1 to 100000, not 1.5"),
        ({"seed": -1}, "seed must be a whole number from 0 to 2147483647, not -1"),
        ({"total_timesteps": 0}, "total_timesteps must be a whole number from 1 to 1000000000000, not 0"),
        ({"max_episode_steps": -1}, "max_episode_steps must be"),
        ({"history": 0}, "history must be a whole number from 1 to 1000, not 0"),
        ({"history_actions": -1}, "history_actions must be a whole number from 0 to 1000, not -1"),
        ({"hybrid": {"imitation_timesteps": -1}}, "imitation_timesteps must be"),
        ({"sde_sample_freq": 0.5}, "sde_sample_freq must be"),
        ({"save_freq": 0}, "save_freq must be"),
        ({"eval_freq": -1}, "eval_freq must be"),
        ({"n_eval_episodes": 0}, "n_eval_episodes must be"),
        ({"patience": -1}, "patience must be"),
        ({"num_threads": 0}, "num_threads must be"),
        ({"curriculum_steps": -1}, "curriculum_steps must be"),
        ({"batch_size": 0}, "batch_size must be"),
        ({"hybrid": {"action_repeat": 0}}, "action_repeat must be a whole number from 1 to 1000, not 0"),
        ({"net_arch": (0,)}, r"net_arch\[0\] must be a whole number"),
        ({"net_arch": 64}, "net_arch"),
        ({"input_scales": 8.0}, "input_scales must be a list of numbers, not 8.0"),
        ({"input_scales": (8.0, -1.0)}, r"input_scales\[1\] must be a finite number in \[1e-06, 1e\+06\], not -1.0"),
        ({"gamma": 5.0}, r"gamma must be a finite number in \[0, 1\], not 5.0"),
        ({"max_seconds": -3.0}, "max_seconds must be a finite number"),
        ({"final_learning_rate": -1e-3}, "final_learning_rate must be a finite number"),
        ({"learning_rate": 0.0}, r"learning_rate must be a finite number in \[1e-12, 1e\+06\]"),
        ({"learning_rate": "fast"}, "learning_rate must be a number, not 'fast'"),
        ({"reward_scale": 0.0}, r"reward_scale must be a finite number in \[1e-09, 1e\+09\]"),
        ({"hybrid": {"action_scale": 0.0}}, "action_scale must be above zero"),
        ({"hybrid": {"action_scale": 4.0}}, r"action_scale .* \[0, 3\], not 4.0"),
        ({"hybrid": {"fallback_gain": -1.0}}, "fallback_gain .* not -1"),
        ({"hybrid": {"fallback_gain": 1.0}}, "fallback_gain must be 0 with mode 'estimate_only', not 1"),
        ({"algo": "dqn"}, "algo must be one of ppo, sac, tqc, apg, not 'dqn'"),
        ({"activation_fn": "foo"}, "activation_fn must be one of relu, tanh, elu, not 'foo'"),
        ({"hybrid": {"base_controller": "pid"}}, "base_controller must be one of adrc-paper, .*, not 'pid'"),
        (
            {"hybrid": {"base_controller": "lqr", "mode": "wheel"}},
            "mode must be one of estimate_only, residual_action, bandwidth_scheduling, not 'wheel'",
        ),
        (
            {"hybrid": {"mode": "residual_action"}},
            "mode 'residual_action' needs a base_controller",
        ),
        ({"hybrid": {"imitation_timesteps": 100}}, "imitation_timesteps needs a base_controller"),
        ({"hybrid": {"imitation_timesteps": 100, **RESIDUAL}}, "imitation_timesteps must be 0 with mode 'residual_act"),
        ({"patience": 3}, "patience needs eval_freq"),
        ({"curriculum": ("calm",)}, "curriculum and curriculum_steps must be given together"),
        ({"curriculum_steps": 100}, "curriculum and curriculum_steps must be given together"),
        ({"batch_size": 1000}, r"batch_size must divide num_envs \* ppo.n_steps = 16384, not be 1000"),
        ({"scenarios": ()}, "scenarios must name at least one"),
        ({"scenarios": "nix"}, "no scenario 'nix'"),
        ({"scenarios": "test"}, "scenarios cannot be .test., which is held out"),
        ({"scenarios": 5}, "scenarios must be one scenario or a list of scenarios, not 5"),
        ({"scenarios": (5,)}, "scenarios"),
        ({"curriculum": ("nix",), "curriculum_steps": 10}, "no scenario 'nix'"),
        (
            {"scenarios": ("calm", "windy", "breeze")},
            "num_envs must be a multiple of the number of scenarios, 3, not 256",
        ),
        ({"scenarios": "training", "num_envs": 12}, "num_envs must be a multiple of the number of scenarios, 8,"),
        (
            {"curriculum": ("training",), "curriculum_steps": 8, "num_envs": 4, "batch_size": 256},
            "of the number of scenarios, 8,",
        ),
        ({"ppo": {"n_epochs": 0}}, "n_epochs must be a whole number from 1 to 1000, not 0"),
        ({"ppo": {"n_steps": 0}}, "n_steps must be"),
        (
            {"ppo": {"critic_warmup_steps": -1}},
            "critic_warmup_steps must be a whole number from 0 to 1000000000000, not -1",
        ),
        ({"ppo": {"gae_lambda": 1.5}}, "gae_lambda must be a finite number"),
        ({"ppo": {"clip_range": 0.0}}, r"clip_range must be a finite number in \[1e-06, 100\]"),
        ({"ppo": {"ent_coef": -1.0}}, "ent_coef must be"),
        ({"ppo": {"log_std_init": float("nan")}}, "log_std_init must be a finite number"),
        ({"ppo": {"tau": 0.5}}, "ppo has no field 'tau'; its fields are n_steps"),
        ({"ppo": 5}, "ppo must be a PpoSettings or a mapping"),
        ({"sac": {"gradient_steps": 0}}, "gradient_steps must be"),
        ({"sac": {"buffer_size": 0}}, "buffer_size must be"),
        ({"sac": {"learning_starts": 0}}, "learning_starts must be"),
        ({"sac": {"tau": 2.0}}, "tau must be a finite number"),
        ({"sac": {"ent_coef_init": 0.0}}, r"ent_coef_init must be a finite number in \[1e-09, 1e\+06\]"),
        ({"sac": {"target_entropy": "low"}}, "target_entropy must be a number, not 'low'"),
        ({"reward": {"tip": 2.0}}, "tip must be a finite number"),
        ({"reward": {"fun": 2.0}}, "reward has no field 'fun'"),
        ({"hybrid": {"action_repeat": 2}}, "action_repeat must be 1 with mode 'estimate_only', not 2"),
        (
            {"hybrid": {"action_repeat": 7, **RESIDUAL}},
            "action_repeat must divide the 1000 control steps of an episode, not be 7",
        ),
        ({"hybrid": {"baseline_relative_reward": True}}, "baseline_relative_reward needs a base_controller"),
        ({"hybrid": {"failure_penalty": 3.0, **RESIDUAL}}, "failure_penalty needs baseline_relative_reward"),
        (
            {"hybrid": {"baseline_relative_reward": True, **RESIDUAL}, "gamma": 1.0},
            "baseline_relative_reward needs a gamma below 1",
        ),
        ({"hybrid": {"scale": 1.0}}, "hybrid has no field 'scale'; its fields are base_controller"),
        ({"hybrid": "flatness"}, "hybrid must be a HybridSettings or a mapping"),
    ],
    ids=str,
)
def test_invalid_settings_are_refused(setting: dict[str, Any], message: str) -> None:
    assert_refused(lambda: TrainSettings(**setting), message, (ValueError, TypeError))


def test_batch_size_must_divide_the_rollout_of_ppo_only() -> None:
    with pytest.raises(ValueError, match="batch_size must divide"):
        TrainSettings(batch_size=1000)
    assert replace(TrainSettings(algo="sac"), batch_size=1000).batch_size == 1000
