"""Training runs, keeps its origin, can be repeated, and says when it fails."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from quadpend_gym import RewardWeights, Simulation
from quadpend_train.evaluation.episodes import TEST_SEED, VALIDATION_SEED, run_episodes
from quadpend_train.policies.mlp_policy import PLAIN_INTERFACE, MlpPolicy, weight_difference
from quadpend_train.scenarios import find_scenario, scenario_hash
from quadpend_train.training import callbacks, dagger, validation
from quadpend_train.training import train as training
from quadpend_train.training.algorithms import make_model
from quadpend_train.training.callbacks import first_episode, read_curve
from quadpend_train.training.environment import make_env, scenarios_at
from quadpend_train.training.settings import HybridSettings, TrainSettings, from_mapping, read_settings
from quadpend_train.training.validation import validate
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same
from tests.helpers.training import BRIEF, BRIEF_SAC, OTHER, SHORT, model_of, numbers_of, trained

RESIDUAL = HybridSettings("flatness", "residual_action", action_scale=0.3)
EVALUATED = replace(BRIEF, eval_freq=256)
SAC_BRIEF = replace(BRIEF_SAC, total_timesteps=256)


class Told(BaseCallback):
    """Calls a function with the model at the start of every rollout."""

    def __init__(self, tell: Any) -> None:
        super().__init__()
        self.tell = tell

    def _on_rollout_start(self) -> None:
        self.tell(self.model)

    def _on_step(self) -> bool:
        return True


def test_a_run_folder_holds_all_that_the_run_is(tmp_path: Path) -> None:
    path = training.train(EVALUATED, tmp_path, progress=False)
    assert path == tmp_path / "policy.npz"
    assert model_of(tmp_path, EVALUATED).num_timesteps == EVALUATED.total_timesteps
    assert read_settings(str(tmp_path / "settings.json")) == EVALUATED
    origin = json.loads((tmp_path / "provenance.json").read_text())
    assert {"command", "commit", "python", "packages"} <= set(origin)
    names = {item.name for item in tmp_path.iterdir() if not item.name.startswith("events")}
    assert names == {"settings.json", "provenance.json", "curve.csv", "best.npz", "model.zip", "policy.npz"}


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
def test_the_same_settings_give_the_same_weights_and_other_seeds_give_others(algo: str, tmp_path: Path) -> None:
    settings = BRIEF if algo == "ppo" else replace(SAC_BRIEF, algo=algo)
    first, second = (trained(settings, tmp_path / name) for name in "ab")
    assert weight_difference(first, second) == 0.0
    assert_same(*(numbers_of(model_of(tmp_path / name, settings)) for name in "ab"))
    assert weight_difference(first, trained(replace(settings, seed=1), tmp_path / "c")) > 0.0


def test_the_card_says_where_a_policy_comes_from(tmp_path: Path) -> None:
    settings = replace(EVALUATED, scenario=(SHORT, OTHER), seed=3)
    policy = trained(settings, tmp_path)
    card = json.loads(json.dumps(policy.card))
    assert card["settings"] == json.loads((tmp_path / "settings.json").read_text())
    assert card["seed"] == 3
    assert card["steps"] == settings.total_timesteps
    assert card["seconds"] >= 0.0
    assert {name: card[name] for name in PLAIN_INTERFACE} == settings.policy_interface()
    assert card["provenance"] == json.loads((tmp_path / "provenance.json").read_text())
    assert card["curve"] == [list(score) for score in read_curve(tmp_path)]
    assert card["scenarios"] == {name: scenario_hash(find_scenario(name)) for name in settings.scenario}
    survival, rmse = validate(policy, settings)
    assert card["score"] == {"survival": survival, "penalised_rmse": rmse}
    assert card["score"]["penalised_rmse"] == min(score[3] for score in card["curve"])


def test_a_run_is_repeated_from_the_card_of_its_policy(tmp_path: Path) -> None:
    settings = replace(EVALUATED, hybrid=RESIDUAL, history=2, reward=RewardWeights(tip=0.2))
    policy = trained(settings, tmp_path / "first")
    again = from_mapping(policy.card["settings"], "the card")
    assert again == settings == read_settings(str(tmp_path / "first" / "policy.npz"))
    assert weight_difference(trained(again, tmp_path / "again"), policy) == 0.0


def test_without_evaluations_the_last_policy_is_kept(tmp_path: Path) -> None:
    policy, seen = trained(BRIEF, tmp_path), np.random.default_rng(0).normal(size=(20, 36)).astype(np.float32)
    expected, _ = model_of(tmp_path, BRIEF).predict(seen, deterministic=True)
    np.testing.assert_allclose(policy.predict(seen)[0], expected, atol=1e-5)
    assert policy.card["curve"] == []


def scored(patch: pytest.MonkeyPatch, *scores: float) -> list[MlpPolicy]:
    """Evaluations have these penalised RMSEs; returns the policies that will be evaluated."""
    evaluated: list[MlpPolicy] = []

    def score(policy: MlpPolicy, settings: TrainSettings) -> tuple[float, float]:
        evaluated.append(policy)
        return 1.0, scores[min(len(evaluated), len(scores)) - 1]

    patch.setattr(callbacks, "validate", score)
    return evaluated


def test_with_evaluations_the_best_policy_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated = scored(monkeypatch, 0.5, 0.4, 0.3, 0.35, 0.3)
    policy = trained(EVALUATED, tmp_path)
    assert [score.steps for score in read_curve(tmp_path)] == [0, 256, 512, 768, 1024]
    assert [score.penalised_rmse for score in read_curve(tmp_path)] == [0.5, 0.4, 0.3, 0.35, 0.3]
    assert weight_difference(policy, evaluated[2]) == 0.0
    assert weight_difference(policy, evaluated[3]) > 0.0
    assert [score.seconds for score in read_curve(tmp_path)] == sorted(score.seconds for score in read_curve(tmp_path))


def test_patience_ends_a_run_that_gets_no_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated = scored(monkeypatch, 0.5, 0.3, 0.4, 0.35, 0.36)
    settings = replace(EVALUATED, total_timesteps=10**8, patience=2)
    policy = trained(settings, tmp_path)
    steps = [score.steps for score in read_curve(tmp_path)]
    assert steps[:4] == [0, 256, 512, 768]
    assert steps[-1] <= 1024
    assert weight_difference(policy, evaluated[1]) == 0.0


def test_what_is_evaluated_is_what_is_trained_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In all scenarios alike, in episodes of the evaluation's own; not in those of the curriculum."""
    flown: list[Any] = []
    seeds: set[int] = set()
    together, rollout = validation.together, validation.rollout

    def watched(scenarios: Any, rows: int, *more: Any) -> Any:
        flown.append((list(scenarios), rows))
        return together(scenarios, rows, *more)

    def seeded(policy: Any, env: Any, seed: int, *more: Any) -> Any:
        seeds.add(seed)
        return rollout(policy, env, seed, *more)

    monkeypatch.setattr(validation, "concatenate_scenarios", watched)
    monkeypatch.setattr(validation, "rollout", seeded)
    third = json.dumps({**json.loads(SHORT), "wind": "storm"})
    settings = replace(
        EVALUATED, scenario=(SHORT, OTHER), curriculum=(third,), curriculum_steps=512, total_timesteps=512
    )
    trained(settings, tmp_path)
    assert len(flown) == 4
    expected = [find_scenario(name) for name in settings.scenario]
    assert all(scenarios == expected and rows == 4 for scenarios, rows in flown)
    assert seeds == {VALIDATION_SEED, training.CARD_SEED}


def test_an_evaluation_is_a_flight_as_others_see_it() -> None:
    """Its score is that of `fly`."""
    settings = replace(BRIEF, scenario=("hover",), seed=4)
    policy = training.export(training.fresh_model(settings, None), **settings.policy_interface())
    flights = run_episodes([policy], "hover", 2)
    assert validate(policy, settings) == (flights.survived.mean(), flights.penalised_rmse.mean())


def test_the_companion_believes_the_same_in_training_and_in_an_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    believed: list[Simulation] = []
    rollout = validation.rollout

    def watched(policy: Any, *more: Any) -> Any:
        believed.append(policy.hybrid.base_controller.simulation)
        return rollout(policy, *more)

    monkeypatch.setattr(validation, "rollout", watched)
    heavy = json.dumps({**json.loads(SHORT), "simulation": {"parameters": {"bob_mass": 0.35}}})
    settings = replace(BRIEF, hybrid=RESIDUAL, scenario=(heavy,))
    model = training.fresh_model(settings, None)
    validate(training.export(model, **settings.policy_interface()), settings)
    assert model.get_env().env.hybrid.base_controller.simulation == find_scenario(heavy).simulation
    assert believed == [find_scenario(heavy).simulation]


def test_tensorboard_has_the_terms_of_the_reward_and_the_evaluations(tmp_path: Path) -> None:
    for name, settings in (("ppo", EVALUATED), ("sac", replace(SAC_BRIEF, eval_freq=128))):
        trained(settings, tmp_path / name)
        (folder,) = (tmp_path / name).glob("events*")
        events = EventAccumulator(str(folder)).Reload()
        terms = {"tracking", "upright", "yaw", "effort", "tracking_error"}
        assert {f"reward/{term}" for term in terms} | {"evaluation/penalised_rmse", "evaluation/survival"} <= set(
            events.Tags()["scalars"]
        )
        for term in terms - {"tracking_error"}:
            assert all(0.0 < event.value <= 1.0 for event in events.Scalars(f"reward/{term}"))
        assert all(0.0 < event.value < 1.0 for event in events.Scalars("reward/tracking_error"))


def test_training_ends_when_its_time_is_up(tmp_path: Path) -> None:
    trained(replace(BRIEF, total_timesteps=10**9, max_seconds=0.3), tmp_path)
    assert model_of(tmp_path, BRIEF).num_timesteps < 10**6


@pytest.mark.parametrize(
    "settings", [BRIEF, EVALUATED, replace(SAC_BRIEF, eval_freq=64)], ids=["ppo", "evaluated", "sac"]
)
def test_a_run_that_diverges_ends_with_a_sentence(settings: TrainSettings, tmp_path: Path) -> None:
    """And with no policy."""

    def spoil(model: Any) -> None:
        if model.num_timesteps >= 64:
            with torch.no_grad():
                next(iter((model.policy if settings.algo == "ppo" else model.actor).parameters()))[0] = np.nan

    assert_refused(
        lambda: trained(settings, tmp_path, more=[Told(spoil)]),
        r"training diverged within \d+ steps: the networks hold numbers that are not finite; lower learning_rate",
        FloatingPointError,
    )
    assert not (tmp_path / "policy.npz").exists()


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
def test_a_learning_rate_that_is_far_too_high_diverges(algo: str, tmp_path: Path) -> None:
    settings = replace(BRIEF if algo == "ppo" else BRIEF_SAC, algo=algo, learning_rate=1e6, final_learning_rate=1e6)
    assert_refused(lambda: trained(settings, tmp_path), "training diverged within", FloatingPointError)


def test_the_critic_may_learn_alone_at_first(tmp_path: Path) -> None:
    seen: dict[int, dict[str, Any]] = {}

    def keep(model: Any) -> None:
        state = model.policy.state_dict()
        seen[model.num_timesteps] = {name: value.clone() for name, value in state.items()}

    trained(replace(BRIEF, ppo=replace(BRIEF.ppo, critic_warmup_steps=512)), tmp_path, more=[Told(keep)])
    for name, first in seen[0].items():
        learned_early = not torch.equal(first, seen[512][name])
        assert learned_early == ("value" in name), name
        assert not torch.equal(seen[512][name], seen[768][name]), name


def test_the_curriculum_comes_in_order() -> None:
    settings = replace(BRIEF, scenario=(SHORT,), curriculum=("calm", "breeze", OTHER), curriculum_steps=300)
    stages = [scenarios_at(settings, steps) for steps in (0, 99, 100, 199, 200, 299, 300, 10**6)]
    assert stages == [("calm",)] * 2 + [("breeze",)] * 2 + [(settings.curriculum[2],)] * 2 + [settings.scenario] * 2


@pytest.mark.parametrize("save_freq", [256, 1_000_000])
def test_every_stage_of_the_curriculum_is_trained_in(save_freq: int, tmp_path: Path) -> None:
    """For its share of the steps, however far apart the checkpoints are."""
    stages: list[float] = []

    def look(model: Any) -> None:
        stages.append(model.get_env().env.unwrapped.world.task.limits.pendulum_angle)

    tasks = [json.dumps({"task": {"limits": {"pendulum_angle": angle}}}) for angle in (0.03, 0.04, 0.05)]
    settings = replace(
        BRIEF,
        scenario=tasks[2:],  # type: ignore[arg-type]
        curriculum=tasks[:2],  # type: ignore[arg-type]
        curriculum_steps=512,
        save_freq=save_freq,
    )
    trained(settings, tmp_path, more=[Told(look)])
    assert stages == [0.03, 0.04, 0.05, 0.05]


@pytest.mark.parametrize(("kind", "settings"), [(PPO, BRIEF), (SAC, SAC_BRIEF)], ids=["ppo", "sac"])
def test_an_exploration_lasts_its_steps(
    kind: Any, settings: TrainSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of gSDE; PPO begins another with every rollout."""
    drawn: set[int] = set()
    model = make_model(replace(settings, sde_sample_freq=8), make_env(settings), None)
    part = model.policy if kind is PPO else model.actor
    reset = part.reset_noise

    def noise(rows: int = 1) -> None:
        if rows == settings.num_envs:  # not for a batch that is learned from
            drawn.add(model.num_timesteps)
        reset(rows)

    monkeypatch.setattr(part, "reset_noise", noise)
    model.learn(256)
    assert drawn == {0, 128}


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
@pytest.mark.parametrize("sde_sample_freq", [0, 4])
def test_who_steers_begins_with_the_companion_alone(algo: str, sde_sample_freq: int) -> None:
    settings = replace(BRIEF, hybrid=RESIDUAL, algo=algo, sde_sample_freq=sde_sample_freq)
    model = make_model(settings, make_env(settings), None)
    seen = np.random.default_rng(0).normal(size=(50, 49)).astype(np.float32)
    alone = replace(settings, hybrid=HybridSettings("flatness"))
    untouched = make_model(alone, make_env(alone), None)
    wild, _ = untouched.predict(seen[:, :45], deterministic=True)
    calm, _ = model.predict(seen, deterministic=True)
    assert np.abs(calm).max() < 0.1
    assert np.abs(calm).mean() < 0.5 * np.abs(wild).mean()


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc"])
def test_imitation_brings_a_policy_near_its_companion(algo: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Round by round, on all that the companion has said so far; in the end far nearer than doing nothing."""
    rounds: list[tuple[float, float, float]] = []

    def fit(model: Any, optimizer: Any, seen: Any, wanted: Any, *more: Any) -> float:
        def off() -> float:
            return float(np.sqrt(np.mean((model.predict(seen, deterministic=True)[0] - wanted) ** 2)))

        before = off()
        left = fitted(model, optimizer, seen, wanted, *more)
        rounds.append((before, off(), float(np.sqrt(np.mean(wanted**2)))))
        return left

    fitted = dagger._fit
    monkeypatch.setattr(dagger, "_fit", fit)
    monkeypatch.setattr(dagger, "_BATCH_SIZE", 32)
    training.fresh_model(
        replace(
            BRIEF,
            algo=algo,
            scenario=("calm",),
            hybrid=HybridSettings("lqr", imitation_timesteps=640),
            net_arch=(32,),
        ),
        None,
    )
    assert len(rounds) == 10
    assert all(after < before for before, after, _ in rounds)
    assert rounds[-1][1] < 0.6 * rounds[-1][2]


def test_no_two_runs_and_no_evaluation_share_an_episode() -> None:
    blocks = [first_episode(TrainSettings(seed=seed)) for seed in range(3)]
    rows = 2**31  # more than rows and steps of any run
    assert all(after - before > rows for before, after in pairwise(blocks))
    assert blocks[0] > max(TEST_SEED, VALIDATION_SEED) + rows


@pytest.mark.parametrize("settings", [BRIEF, SAC_BRIEF], ids=["ppo", "sac"])
def test_a_fresh_run_begins_with_the_episodes_of_its_block(settings: TrainSettings, tmp_path: Path) -> None:
    begun: list[Any] = []
    trained(settings, tmp_path, more=[Told(lambda model: begun.append(model._last_obs.copy()))])
    expected = make_env(settings)
    expected.seed(first_episode(settings))
    assert_array_equal(begun[0], expected.reset())


def test_the_learner_is_rewarded_for_what_the_settings_say() -> None:
    settings = replace(BRIEF, reward=RewardWeights(tracking=0.0, upright=0.0, yaw=0.0, effort=1.0), reward_scale=0.5)
    env = make_env(settings)
    env.reset()
    _, reward, _, _ = env.step(np.tile(np.float32([0.5, 0.0, 0.0, 0.0]), (16, 1)))
    np.testing.assert_allclose(reward, 0.5 / 1.25, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": ("calm", "output_feedback")}, "same observation space"),
        (
            {"hybrid": {"base_controller": "lqr", "mode": "bandwidth_scheduling"}},
            "only the flatness-based controller has",
        ),
        (
            {"hybrid": {"base_controller": "lqr", "mode": "residual_action", "action_scale": 4.0}},
            "action_scale .* not 4.0",
        ),
        ({"hybrid": RESIDUAL, "scenario": json.dumps({"history": 2})}, "36 or 27 numbers"),
        ({"hybrid": RESIDUAL, "scenario": json.dumps({"actuators": "rotors"})}, "where rotors are commanded"),
    ],
    ids=str,
)
def test_a_run_that_cannot_begin_leaves_no_folder_behind(changes: Any, message: str, tmp_path: Path) -> None:
    """So that it can be tried again in the same place."""
    assert_refused(lambda: trained(replace(BRIEF, **changes), tmp_path / "run"), message, (ValueError, TypeError))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("other", "beside"),
    [("output_feedback", {}), (json.dumps({"simulation": {"period": 0.02}}), {"hybrid": RESIDUAL})],
    ids=["observation", "simulation"],
)
def test_stages_of_a_curriculum_that_do_not_fit_are_refused_at_once(other: str, beside: dict[str, Any]) -> None:
    """And not in the middle of a run, nor never."""

    def begin() -> None:
        training.fresh_model(replace(BRIEF, **beside, curriculum=(other,), curriculum_steps=256, save_freq=256), None)

    assert_refused(begin, "curriculum|same", ValueError)
