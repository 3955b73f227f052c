"""Files that version 0.1 wrote are still read: policies, interrupted runs, settings, and names.

`tests/data/version_0_1` has three small training runs of version 0.1. `known.json` has hashes of their final weights
and of the results of 20 episodes, computed by version 0.1 on one machine. On the same kind of machine with the same
packages everything must be exactly equal. Elsewhere float32 sums may be rounded differently, and results and resumed
training are compared with a tolerance.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines import Policy
from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.vehicle_gains import gains_for
from quadpend_baselines.estimation.chains import DISTURBANCE, FORCE, HORIZONTAL
from quadpend_baselines.gains import GAINS
from quadpend_train.common.version_0_1 import current_card, current_name, current_settings, provenance_file
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.policies.loading import load_policy, policy_names
from quadpend_train.policies.mlp_policy import PLAIN_INTERFACE, MlpPolicy, weight_difference
from quadpend_train.training import train as training
from quadpend_train.training.settings import (
    HybridSettings,
    PpoSettings,
    SacSettings,
    TrainSettings,
    from_mapping,
    read_settings,
)
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import layers
from tests.helpers.sources import ROOT

FOLDER = ROOT / "tests" / "data" / "version_0_1"
KNOWN = json.loads((FOLDER / "known.json").read_text(encoding="utf-8"))
PROCESSOR = ("model name", "cpu family", "model", "stepping")
RUNS = ("ppo", "ppo-pace", "sac-residual")
every_run = pytest.mark.parametrize("name", RUNS)


@pytest.fixture(autouse=True)
def flatness_without_estimate_of_the_mass(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Give `flatness`, the base controller of the hybrids, its gains of version 0.1."""
    gains = GAINS["flatness"]
    estimator = replace(gains.estimator, mass_time=0.0)
    with monkeypatch.context() as patch:
        patch.setitem(GAINS, "flatness", replace(gains, estimator=estimator))
        gains_for.cache_clear()
        yield
    gains_for.cache_clear()


@pytest.fixture(autouse=True)
def matched_law_without_estimate_of_the_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give `adrc-matched` its law of version 0.1, which took ϑ̂/K for the force."""

    def compensated(law: ADRC, estimate: Any, order: int) -> Any:
        share = law.gains.mismatch / law.simulation.parameters.chain_stiffness
        return share * estimate[:, HORIZONTAL, DISTURBANCE + order]

    def disturbance(law: ADRC, estimate: Any) -> Any:
        old = estimate.copy()
        if law.gains.mismatch:
            old[:, FORCE] = old[:, HORIZONTAL]
        return of_present_law(law, old)

    of_present_law = ADRC._disturbance
    monkeypatch.setattr(ADRC, "_compensated", compensated)
    monkeypatch.setattr(ADRC, "_disturbance", disturbance)


def same_machine() -> bool:
    """Whether processor and packages are those on which version 0.1 computed the known hashes."""
    information = Path("/proc/cpuinfo")
    text = information.read_text(encoding="utf-8") if information.exists() else ""
    processor = [re.findall(rf"^{name}\s*: (.*)$", text, re.MULTILINE)[:1] for name in PROCESSOR]
    packages = KNOWN["machine"]["packages"]
    same_processor = [name for found in processor for name in found] == KNOWN["machine"]["processor"]
    return same_processor and packages == {name: version(name) for name in packages}


def digest(arrays: Any) -> str:
    """Hash of arrays, as `known.json` has it."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:24]


def weights_digest(policy: MlpPolicy) -> str:
    return digest([array for layer in policy.layers for array in layer])


def assert_known_results(policy: Policy, name: str) -> None:
    """The results of 20 episodes are those of version 0.1."""
    results = run_episodes([policy], "windy", 20, 5)
    if same_machine():
        assert digest(results) == KNOWN[name]["results"]
    assert_allclose(results.survived.mean(), KNOWN[name]["survival"], atol=1e-9)
    assert_allclose(results.penalised_rmse.mean(), KNOWN[name]["penalised_rmse"], rtol=1e-3)


@every_run
def test_policy_file_has_the_same_weights_and_the_same_results(name: str) -> None:
    policy = MlpPolicy.load(FOLDER / name / "policy_of_0.1.npz")
    assert weights_digest(policy) == KNOWN[name]["weights"]
    assert_known_results(policy, name)


def test_policy_that_an_earlier_version_shipped_has_the_same_results() -> None:
    """`ppo-gain-scheduling-0` was trained again since; this is the file that was shipped as `ppo-pace-0`."""
    assert_known_results(MlpPolicy.load(FOLDER / "ppo-pace-0.npz"), "ppo-pace-0")


def test_old_name_of_a_shipped_policy_loads_the_current_policy() -> None:
    policy = load_policy("ppo-pace-0")
    assert isinstance(policy, MlpPolicy)
    assert weights_digest(policy) == weights_digest(MlpPolicy.load("ppo-gain-scheduling-0"))


@every_run
def test_interrupted_run_is_resumed_to_the_same_weights(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checkpoint has the folder of TensorBoard's events as a relative path, below ``runs``."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / name / "interrupted"
    shutil.copytree(FOLDER / name / "interrupted", folder)
    policy = MlpPolicy.load(training.resume(folder, progress=False))
    if same_machine():
        assert weights_digest(policy) == KNOWN[name]["weights"]
    assert weight_difference(policy, MlpPolicy.load(FOLDER / name / "policy_of_0.1.npz")) < 0.01
    assert policy.card["provenance"] == json.loads((folder / "origin.json").read_text(encoding="utf-8"))
    assert policy.card["settings"] == json.loads(
        json.dumps(training.to_mapping(read_settings(str(folder / "policy.npz"))))
    )


@every_run
def test_settings_of_a_run_are_those_on_the_card_of_its_policy(name: str) -> None:
    settings = read_settings(str(FOLDER / name / "interrupted" / "settings.json"))
    path = FOLDER / name / "policy_of_0.1.npz"
    assert read_settings(str(path)) == settings
    card = MlpPolicy.load(path).card
    assert {field: card[field] for field in PLAIN_INTERFACE} == settings.policy_interface()
    assert card["provenance"]["packages"]
    assert not {"view", "origin"} & set(card)


def test_hybrids_of_a_run_have_current_names() -> None:
    scheduling = read_settings(str(FOLDER / "ppo-pace" / "interrupted" / "settings.json"))
    assert scheduling.hybrid == HybridSettings(
        "flatness",
        "bandwidth_scheduling",
        action_scale=1.0,
        fallback_gain=3.0,
        action_repeat=5,
        baseline_relative_reward=True,
        failure_penalty=2.0,
    )
    residual = read_settings(str(FOLDER / "sac-residual" / "interrupted" / "settings.json"))
    assert residual.hybrid == HybridSettings("adrc-matched", "residual_action", action_scale=0.3)


def test_settings_file_with_old_names_is_read(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text(
        "total_steps = 1024\nepisode_steps = 200\ndiscount = 0.9\nhidden = [32]\nactivation = 'tanh'\nseed = 3\n"
        "exploration_steps = 4\ncheckpoint_steps = 300\nevaluation_steps = 200\nevaluation_episodes = 4\nthreads = 2\n"
        "companion = 'flatness'\nsteers = 'alone'\nauthority = 0.5\nhold = 1\nimitation_steps = 100\npaired = true\n"
        "fall_cost = 2.0\ncaution = 0.0\n"
        "[ppo]\nrollout_steps = 32\nepochs = 2\nentropy_coefficient = 0.1\ninitial_log_std = -1.0\ncritic_steps = 9\n"
        "[sac]\ninitial_entropy_coefficient = 0.2\ntau = 0.1\n",
        encoding="utf-8",
    )
    assert read_settings(str(path)) == TrainSettings(
        seed=3,
        total_timesteps=1024,
        max_episode_steps=200,
        gamma=0.9,
        net_arch=(32,),
        activation_fn="tanh",
        sde_sample_freq=4,
        save_freq=300,
        eval_freq=200,
        n_eval_episodes=4,
        num_threads=2,
        hybrid=HybridSettings(
            "flatness",
            action_scale=0.5,
            imitation_timesteps=100,
            baseline_relative_reward=True,
            failure_penalty=2.0,
        ),
        ppo=PpoSettings(n_steps=32, n_epochs=2, ent_coef=0.1, log_std_init=-1.0, critic_warmup_steps=9),
    )


def test_the_tables_of_other_algorithms_in_an_old_file_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    tables = "[ppo]\nepochs = 2\n[sac]\ninitial_entropy_coefficient = 0.2\ntau = 0.1\n"
    path.write_text(f"algo = 'sac'\ntotal_steps = 1024\n{tables}", encoding="utf-8")
    assert read_settings(str(path)) == TrainSettings(
        algo="sac", total_timesteps=1024, sac=SacSettings(ent_coef_init=0.2, tau=0.1)
    )


def test_training_scenarios_under_their_old_name_are_read() -> None:
    assert from_mapping({"scenario": ["calm"]}, "a test") == TrainSettings(scenarios=("calm",))
    card = MlpPolicy.load(FOLDER / "ppo-pace-0.npz").card  # this file has the old name
    assert card["settings"]["scenarios"] == ["training"]
    assert "scenario" not in card["settings"]


def test_settings_with_current_names_are_not_changed() -> None:
    settings = training.to_mapping(read_settings("ppo-gain-scheduling"))
    assert current_settings(settings, "a test") == settings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scenario = 'calm'\nscenarios = 'windy'\n", "old.toml sets scenarios twice"),
        ("total_steps = 5\ntotal_timesteps = 6\n", "old.toml sets total_timesteps twice"),
        ("companion = 'lqr'\n[hybrid]\nbase_controller = 'lqi'\n", "old.toml sets hybrid.base_controller twice"),
        ("[ppo]\nepochs = 5\nn_epochs = 6\n", "old.toml sets n_epochs twice"),
        ("companion = 'lqr'\nsteers = 'wheel'\n", "mode must be one of estimate_only, .*, not 'wheel'"),
        ("[sac]\nrollout_steps = 7\n", "old.toml sets 'rollout_steps', which is not a setting"),
        ("companion = 'lqr'\nhybrid = 7\n", "hybrid must be a mapping, not 7"),
    ],
)
def test_contradictory_settings_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text(text, encoding="utf-8")
    assert_refused(lambda: read_settings(str(path)), message, (ValueError, TypeError))


VIEW = {
    "companion": "flatness",
    "steers": "pace",
    "authority": 0.5,
    "hold": 2,
    "history": 1,
    "history_actions": 0,
}
CARD = {"format": "quadpend policy 1", "activation": "relu", "squashed": False, "view": VIEW}


def test_card_without_caution_has_no_fallback() -> None:
    """The earliest cards of version 0.1 do not have this field."""
    card = current_card(CARD)
    assert MlpPolicy(layers(45, 8, 4), card).card == card
    assert card["hybrid"]["fallback_gain"] == 0.0
    assert card["action_repeat"] == 2


@pytest.mark.parametrize("view", [None, {}, {**VIEW, "mirror": True}], ids=str)
def test_card_with_an_invalid_view_is_refused(view: Any) -> None:
    assert_refused(lambda: current_card({**CARD, "view": view}), "view .* must have companion, steers", ValueError)


@pytest.mark.parametrize("card", [None, [], {"format": "quadpend policy 9"}], ids=str)
def test_other_cards_are_not_changed(card: Any) -> None:
    assert current_card(card) == card


def test_old_names_of_policies_and_presets_are_aliases() -> None:
    assert current_name("ppo-pace") == "ppo-gain-scheduling"
    assert current_name("sac-pace-hover-3") == "sac-gain-scheduling-hover-3"
    for name in ("ppo", "ppo-gain-scheduling-0", "my-ppo-pace", "runs/ppo-pace", "ppo-pace-x"):
        assert current_name(name) == name
    assert policy_names("ppo-pace") == [f"ppo-gain-scheduling-{seed}" for seed in range(5)]
    assert read_settings("ppo-pace") == read_settings("ppo-gain-scheduling")
    assert weight_difference(MlpPolicy.load("ppo-pace-0"), MlpPolicy.load("ppo-gain-scheduling-0")) == 0.0


def test_provenance_is_read_from_either_file(tmp_path: Path) -> None:
    assert provenance_file(tmp_path, "provenance.json").name == "provenance.json"
    (tmp_path / "origin.json").touch()
    assert provenance_file(tmp_path, "provenance.json").name == "origin.json"
    (tmp_path / "provenance.json").touch()
    assert provenance_file(tmp_path, "provenance.json").name == "provenance.json"
