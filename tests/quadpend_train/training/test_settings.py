"""Settings of training: files are deltas, names of scenarios become the scenarios, and mistakes are named."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from quadpend_gym import RewardWeights
from quadpend_train.scenarios import SETS, expand_sets
from quadpend_train.training.settings import (
    FOLDER,
    PpoSettings,
    SacSettings,
    TrainSettings,
    from_mapping,
    read_settings,
    to_mapping,
)
from tests.helpers.bad_input import assert_refused
from tests.helpers.mlp_policies import learned

EVERYTHING = TrainSettings(
    algo="tqc",
    scenario=("training", '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'),
    curriculum=("calm", '{"wind": "breeze"}'),
    curriculum_steps=5000,
    num_envs=9,
    companion="flatness",
    steers="pace",
    authority=0.5,
    history=2,
    net_arch=(32,),
    reward=RewardWeights(tip=0.1),
    eval_freq=100,
    patience=3,
    ppo=PpoSettings(n_epochs=9),
    sac=SacSettings(tau=0.1),
)


@pytest.mark.parametrize("settings", [TrainSettings(), EVERYTHING], ids=["defaults", "everything"])
def test_settings_survive_json(settings: TrainSettings) -> None:
    data = json.loads(json.dumps(to_mapping(settings)))
    assert from_mapping(data, "JSON") == settings
    assert TrainSettings(**data) == settings
    assert hash(from_mapping(data, "JSON")) == hash(settings)
    assert set(data) == {field.name for field in fields(TrainSettings)}


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_the_files_of_the_package_are_settings(path: Path) -> None:
    """And train in nothing that is held out."""
    assert read_settings(path.stem) == read_settings(str(path))
    held_out = set(SETS["test"]) - set(SETS["training"])
    assert not held_out & set(expand_sets([*read_settings(path.stem).scenario, *read_settings(path.stem).curriculum]))


def test_settings_files_are_deltas_and_mistakes_in_them_are_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("seed = 7\nhidden = [32]\n[ppo]\nepochs = 5\n[reward]\ntip = 0.2\n")
    expected = TrainSettings(seed=7, net_arch=(32,), ppo=PpoSettings(n_epochs=5), reward=RewardWeights(tip=0.2))
    assert read_settings(str(path)) == expected
    for text, message in (
        ("sead = 7\n", "mine.toml sets 'sead', which is no setting; the settings are algo, scenario"),
        ("[ppo]\nepoch = 7\n", "mine.toml sets 'epoch', which is no setting; the settings are n_steps"),
        ("[sac]\nrollout_steps = 7\n", "mine.toml sets 'n_steps', which is no setting"),
        ("[reward]\nfun = 7\n", "mine.toml sets 'fun', which is no setting; the settings are tracking"),
        ("ppo = 7\n", "ppo"),
        ("reward = [1, 2]\n", "reward"),
    ):
        path.write_text(text)
        assert_refused(lambda: read_settings(str(path)), message, (ValueError, TypeError))
    assert_refused(lambda: read_settings("nix"), "no settings 'nix'; there are demo", ValueError)


def test_the_settings_of_a_policy_are_in_its_card(tmp_path: Path) -> None:
    learned(36, settings=to_mapping(EVERYTHING)).save(tmp_path / "policy.npz")
    assert read_settings(str(tmp_path / "policy.npz")) == EVERYTHING
    learned(36).save(tmp_path / "exported.npz")
    assert_refused(lambda: read_settings(str(tmp_path / "exported.npz")), "exported.npz.* settings", ValueError)
    assert_refused(lambda: read_settings(str(tmp_path / "nix.npz")), "nix.npz", ValueError)


def test_scenarios_are_given_one_by_one_or_together(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('wind = "storm"\n')
    assert TrainSettings(scenario="calm") == TrainSettings(scenario=("calm",)) == TrainSettings(scenario=["calm"])  # type: ignore[arg-type]
    assert TrainSettings(scenario="training").scenario == ("training",)  # type: ignore[arg-type]
    given: Any
    (whole,) = TrainSettings(scenario=(str(path),)).scenario
    path.unlink()  # the settings need it no longer
    for given in ('{"wind": "storm"}', {"wind": "storm"}, [{"wind": "storm"}], whole):
        assert TrainSettings(scenario=given).scenario == (whole,)
    assert json.loads(whole)["wind"]


def test_whole_numbers_are_numbers() -> None:
    """As TOML and people write them: the policy that comes of it is one."""
    settings = TrainSettings(companion="flatness", steers="action", authority=1)
    assert learned(49, settings.view()).card["view"]["authority"] == 1.0
    assert learned(49, settings.view())


TOGETHER: dict[str, Any] = {"companion": "flatness", "steers": "action"}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"num_envs": 1.5}, "num_envs must be a whole number of at least 1, not 1.5"),
        ({"seed": -1}, "seed must be a whole number of at least 0, not -1"),
        ({"total_timesteps": 0}, "total_timesteps must be a whole number of at least 1, not 0"),
        ({"max_episode_steps": 0}, "max_episode_steps must be"),
        ({"history": 0}, "history must be a whole number of at least 1, not 0"),
        ({"history_actions": -1}, "history_actions must be a whole number of at least 0, not -1"),
        ({"imitation_steps": -1}, "imitation_steps must be"),
        ({"sde_sample_freq": 0.5}, "sde_sample_freq must be"),
        ({"save_freq": 0}, "save_freq must be"),
        ({"eval_freq": -1}, "eval_freq must be"),
        ({"n_eval_episodes": 0}, "n_eval_episodes must be"),
        ({"patience": -1}, "patience must be"),
        ({"torch_threads": 0}, "torch_threads must be"),
        ({"curriculum_steps": -1}, "curriculum_steps must be"),
        ({"batch_size": 0}, "batch_size must be"),
        ({"hold": 0}, "hold must be a whole number of at least 1, not 0"),
        ({"net_arch": (0,)}, r"net_arch\[0\] must be a whole number"),
        ({"net_arch": 64}, "net_arch"),
        ({"gamma": 5.0}, r"gamma must be a finite number in \[0, 1\], not 5.0"),
        ({"max_seconds": -3.0}, "max_seconds must be a finite number"),
        ({"final_learning_rate": -1e-3}, "final_learning_rate must be a finite number"),
        ({"learning_rate": 0.0}, "learning_rate must be above zero"),
        ({"learning_rate": "fast"}, "learning_rate must be a number, not 'fast'"),
        ({"reward_scale": 0.0}, "reward_scale must be above zero"),
        ({"authority": 0.0}, "authority must be above zero"),
        ({"caution": -1.0}, "caution .* not -1"),
        ({"caution": 1.0}, "only a learner that steers its companion can be met with caution"),
        ({"algo": "dqn"}, "algo must be one of ppo, sac, tqc, not 'dqn'"),
        ({"activation": "foo"}, "activation must be one of relu, tanh, elu, not 'foo'"),
        ({"companion": "pid"}, "companion must be one of adrc-paper, .*, not 'pid'"),
        ({"companion": "lqr", "steers": "wheel"}, "steers must be one of alone, action, pace, not 'wheel'"),
        ({"steers": "action"}, "a learner that steers or imitates needs a companion"),
        ({"imitation_steps": 100}, "a learner that steers or imitates needs a companion"),
        ({"imitation_steps": 100, **TOGETHER}, "a learner that steers its companion cannot imitate it"),
        ({"patience": 3}, "patience needs eval_freq"),
        ({"curriculum": ("calm",)}, "curriculum and curriculum_steps belong together"),
        ({"curriculum_steps": 100}, "curriculum and curriculum_steps belong together"),
        ({"batch_size": 1000}, r"batch_size must divide num_envs \* ppo.n_steps = 16384, not be 1000"),
        ({"scenario": ()}, "scenario must name at least one"),
        ({"scenario": "nix"}, "no scenario 'nix'"),
        ({"scenario": "test"}, "scenario cannot be .test., which is held out"),
        ({"scenario": 5}, "scenario must be a scenario or several, not 5"),
        ({"scenario": (5,)}, "scenario"),
        ({"curriculum": ("nix",), "curriculum_steps": 10}, "no scenario 'nix'"),
        ({"scenario": ("calm", "windy", "breeze")}, "num_envs must be a multiple of the 3 scenarios .* not 256"),
        ({"scenario": "training", "num_envs": 12}, "num_envs must be a multiple of the 8 scenarios"),
        ({"curriculum": ("training",), "curriculum_steps": 8, "num_envs": 4, "batch_size": 256}, "of the 8 scenarios"),
        ({"ppo": {"n_epochs": 0}}, "n_epochs must be a whole number of at least 1, not 0"),
        ({"ppo": {"n_steps": 0}}, "n_steps must be"),
        ({"ppo": {"critic_warmup_steps": -1}}, "critic_warmup_steps must be a whole number of at least 0, not -1"),
        ({"ppo": {"gae_lambda": 1.5}}, "gae_lambda must be a finite number"),
        ({"ppo": {"clip_range": 0.0}}, "clip_range must be above zero"),
        ({"ppo": {"ent_coef": -1.0}}, "ent_coef must be"),
        ({"ppo": {"log_std_init": float("nan")}}, "log_std_init must be a finite number"),
        ({"ppo": {"tau": 0.5}}, "ppo has no field 'tau'; its fields are n_steps"),
        ({"ppo": 5}, "ppo must be a PpoSettings or a mapping"),
        ({"sac": {"gradient_steps": 0}}, "gradient_steps must be"),
        ({"sac": {"buffer_size": 0}}, "buffer_size must be"),
        ({"sac": {"learning_starts": 0}}, "learning_starts must be"),
        ({"sac": {"tau": 2.0}}, "tau must be a finite number"),
        ({"sac": {"ent_coef_init": 0.0}}, "ent_coef_init must be above zero"),
        ({"sac": {"target_entropy": "low"}}, "target_entropy must be a number, not 'low'"),
        ({"reward": {"tip": 2.0}}, "tip must be a finite number"),
        ({"reward": {"fun": 2.0}}, "reward has no field 'fun'"),
        ({"hold": 2}, "only a learner that steers its companion can hold its action"),
        ({"paired": True}, "a paired reward needs a companion"),
        ({"failure_penalty": 3.0, **TOGETHER}, "only a paired reward has a failure_penalty"),
        ({"paired": True, "gamma": 1.0, **TOGETHER}, "a paired reward needs a gamma below 1"),
    ],
    ids=str,
)
def test_settings_out_of_range_are_refused(setting: dict[str, Any], message: str) -> None:
    assert_refused(lambda: TrainSettings(**setting), message, (ValueError, TypeError))


def test_a_batch_must_divide_the_rollout_of_ppo_only() -> None:
    with pytest.raises(ValueError, match="batch_size must divide"):
        TrainSettings(batch_size=1000)
    assert replace(TrainSettings(algo="sac"), batch_size=1000).batch_size == 1000
