"""Training runs are recorded, can be repeated, and end with a reason when they fail."""

import inspect
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from quadpend_gym import RewardWeights
from quadpend_train.cli.evaluation import evaluate
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.envelope import limit
from quadpend_train.evaluation.episodes import TEST_SEED, TUNING_SEED, VALIDATION_SEED, run_episodes
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import report
from quadpend_train.search.tuning import SCORE_SEED
from quadpend_train.training import callbacks, dagger
from quadpend_train.training import train as training
from quadpend_train.training.algorithms import make_model
from quadpend_train.training.callbacks import first_seed, read_curve, validate
from quadpend_train.training.dagger import Imitation
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import HybridSettings, TrainSettings, from_mapping, read_settings
from quadpend_train.training.train import CARD_SEED
from tests.helpers.bad_input import assert_refused
from tests.helpers.training import (
    BRIEF,
    BRIEF_SAC,
    OTHER,
    SHORT,
    model_of,
    train_policy,
    weight_difference,
    with_arguments,
)

RESIDUAL = HybridSettings("flatness", "residual_action", action_scale=0.3)
EVALUATED = replace(BRIEF, eval_freq=256)
SAC_BRIEF = replace(BRIEF_SAC, total_timesteps=256)


class AtRolloutStart(BaseCallback):
    """Call a function with the model at the start of every rollout."""

    def __init__(self, function: Any) -> None:
        super().__init__()
        self.function = function

    def _on_rollout_start(self) -> None:
        self.function(self.model)

    def _on_step(self) -> bool:
        return True


def test_card_records_how_the_policy_was_trained(tmp_path: Path) -> None:
    settings = replace(EVALUATED, scenarios=(SHORT, OTHER), seed=3)
    policy = train_policy(settings, tmp_path)
    card = json.loads(json.dumps(policy.card))
    names = {item.name for item in tmp_path.iterdir() if not item.name.startswith("events")}
    assert names == {".lock", "settings.json", "provenance.json", "curve.csv", "best.npz", "model.zip", "policy.npz"}
    assert card["settings"] == json.loads((tmp_path / "settings.json").read_text())
    assert card["seed"] == 3
    assert card["steps"] == settings.total_timesteps
    assert card["seconds"] >= 0.0
    assert {"hybrid": card["hybrid"]} == settings.policy_interface()
    assert card["provenance"] == json.loads((tmp_path / "provenance.json").read_text())
    assert card["curve"] == [list(score) for score in read_curve(tmp_path)]
    survival, rmse = validate(policy, settings)
    assert card["score"] == {"survival": survival, "penalised_rmse": rmse}
    assert card["score"]["penalised_rmse"] == min(score[3] for score in card["curve"])


def test_run_can_be_repeated_from_the_card_of_its_policy(tmp_path: Path) -> None:
    settings = replace(EVALUATED, hybrid=RESIDUAL, reward=RewardWeights(tip=0.2))
    policy = train_policy(settings, tmp_path / "first")
    again = from_mapping(policy.card["settings"], "the card")
    assert again == settings == read_settings(str(tmp_path / "first" / "policy.npz"))
    assert weight_difference(train_policy(again, tmp_path / "again"), policy) == 0.0


def test_final_policy_is_saved_without_evaluations(tmp_path: Path) -> None:
    policy, inputs = train_policy(BRIEF, tmp_path), np.random.default_rng(0).normal(size=(20, 36)).astype(np.float32)
    expected, _ = model_of(tmp_path, BRIEF).predict(inputs, deterministic=True)
    np.testing.assert_allclose(policy.predict(inputs)[0], expected, atol=1e-5)
    assert policy.card["curve"] == []


def replace_scores(patch: pytest.MonkeyPatch, *scores: float) -> list[MlpPolicy]:
    """Give evaluations these penalised RMSEs; return the list to which the evaluated policies are added."""
    evaluated: list[MlpPolicy] = []

    def score(policy: MlpPolicy, settings: TrainSettings) -> tuple[float, float]:
        evaluated.append(policy)
        return 1.0, scores[min(len(evaluated), len(scores)) - 1]

    patch.setattr(callbacks, "validate", score)
    return evaluated


def test_the_best_policy_of_a_run_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated = replace_scores(monkeypatch, 0.5, 0.3, 0.4)
    policy = train_policy(EVALUATED, tmp_path)
    assert len(evaluated) >= 3
    assert weight_difference(policy, evaluated[1]) == 0.0


def test_tensorboard_has_reward_terms_and_evaluations(tmp_path: Path) -> None:
    for name, settings in (("ppo", EVALUATED), ("sac", replace(SAC_BRIEF, eval_freq=128))):
        train_policy(settings, tmp_path / name)
        (folder,) = (tmp_path / name).glob("events*")
        events = EventAccumulator(str(folder)).Reload()
        terms = {"tracking", "upright", "yaw", "effort", "tracking_error"}
        assert {f"reward/{term}" for term in terms} | {"evaluation/penalised_rmse", "evaluation/survival"} <= set(
            events.Tags()["scalars"]
        )
        for term in terms - {"tracking_error"}:
            assert all(0.0 < event.value <= 1.0 for event in events.Scalars(f"reward/{term}"))
        assert all(0.0 < event.value < 1.0 for event in events.Scalars("reward/tracking_error"))


@pytest.mark.parametrize(
    "settings", [BRIEF, EVALUATED, replace(SAC_BRIEF, eval_freq=64)], ids=["ppo", "evaluated", "sac"]
)
def test_diverged_run_ends_with_an_error_and_without_a_policy(settings: TrainSettings, tmp_path: Path) -> None:
    def set_nan(model: Any) -> None:
        if model.num_timesteps >= 64:
            with torch.no_grad():
                next(iter((model.policy if settings.algo == "ppo" else model.actor).parameters()))[0] = np.nan

    assert_refused(
        lambda: train_policy(settings, tmp_path, callbacks=[AtRolloutStart(set_nan)]),
        r"training diverged within \d+ steps: the weights of the networks are not finite; lower learning_rate",
        FloatingPointError,
    )
    assert not (tmp_path / "policy.npz").exists()


def test_only_the_critic_learns_during_its_warm_up(tmp_path: Path) -> None:
    states: dict[int, dict[str, Any]] = {}

    def keep(model: Any) -> None:
        state = model.policy.state_dict()
        states[model.num_timesteps] = {name: value.clone() for name, value in state.items()}

    train_policy(replace(BRIEF, critic_warmup_steps=512), tmp_path, callbacks=[AtRolloutStart(keep)])
    for name, first in states[0].items():
        trained_early = not torch.equal(first, states[512][name])
        assert trained_early == ("value" in name), name
        assert not torch.equal(states[512][name], states[768][name]), name


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
@pytest.mark.parametrize("use_sde", [False, True])
def test_hybrid_starts_close_to_its_base_controller(algo: str, use_sde: bool) -> None:
    brief = BRIEF if algo == "ppo" else BRIEF_SAC
    settings = with_arguments(replace(brief, hybrid=RESIDUAL, algo=algo), use_sde=use_sde)
    model = make_model(settings, make_env(settings), None)
    inputs = np.random.default_rng(0).normal(size=(50, 49)).astype(np.float32)
    alone = replace(settings, hybrid=HybridSettings("flatness"))
    default = make_model(alone, make_env(alone), None)
    large, _ = default.predict(inputs[:, :45], deterministic=True)
    small, _ = model.predict(inputs, deterministic=True)
    assert np.abs(small).max() < 0.1
    assert np.abs(small).mean() < 0.5 * np.abs(large).mean()


def test_runs_and_evaluations_share_no_episode() -> None:
    blocks = [first_seed(TrainSettings(seed=seed)) for seed in range(3)]
    largest = 2**31  # more than the seeds that a run uses
    assert all(after - before > largest for before, after in pairwise(blocks))
    assert blocks[0] > max(TEST_SEED, VALIDATION_SEED) + largest


def test_the_default_episodes_of_evaluations_have_selected_nothing() -> None:
    for function in (run_episodes, compare, limit, report.evaluate, evaluate):
        assert inspect.signature(function).parameters["seed"].default == TEST_SEED
    starts = sorted([TEST_SEED, TUNING_SEED, SCORE_SEED, VALIDATION_SEED, CARD_SEED])
    assert starts[0] == TEST_SEED
    assert starts[1] - TEST_SEED > 100_000  # the most episodes of an evaluation


def test_reward_has_the_weights_and_the_scale_of_the_settings() -> None:
    settings = replace(BRIEF, reward=RewardWeights(tracking=0.0, upright=0.0, yaw=0.0, effort=1.0), reward_scale=0.5)
    env = make_env(settings)
    env.reset()
    _, reward, _, _ = env.step(np.tile(np.float32([0.5, 0.0, 0.0, 0.0]), (16, 1)))
    np.testing.assert_allclose(reward, 0.5 / 1.25, rtol=1e-6)


@pytest.mark.parametrize("settings", [BRIEF, replace(BRIEF_SAC, algo="tqc")], ids=["ppo", "tqc"])
def test_imitation_approaches_the_base_controller(settings: TrainSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    """In every round, the error over all labels so far gets smaller."""
    fit, rounds = Imitation._fit, []

    def record_errors(self: Imitation, inputs: Any, targets: Any, rates: Any) -> None:
        def error() -> float:
            return float(np.mean((self.model.predict(inputs, deterministic=True)[0] - targets) ** 2))

        before = error()
        fit(self, inputs, targets, rates)
        rounds.append((before, error(), float(np.mean(targets**2))))

    monkeypatch.setattr(Imitation, "_fit", record_errors)
    monkeypatch.setattr(dagger, "_BATCH_SIZE", 32)
    settings = replace(
        settings, scenarios=("calm",), num_envs=64, hybrid=HybridSettings("lqr", imitation_timesteps=9600)
    )
    settings = with_arguments(settings, policy_kwargs={"net_arch": (32,)})
    training.imitate(training.initial_model(settings), settings)
    assert len(rounds) == 10
    assert all(after < before for before, after, _ in rounds)
    assert rounds[-1][1] < 0.4 * rounds[-1][2]


def test_max_seconds_stop_training(tmp_path: Path) -> None:
    train_policy(replace(BRIEF, total_timesteps=10**9, max_seconds=0.3), tmp_path)
    assert model_of(tmp_path, BRIEF).num_timesteps < 10**6
