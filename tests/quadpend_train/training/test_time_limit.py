"""`max_seconds` counts everything from the start to the policy: set-up, imitation, evaluations, score and saving."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from stable_baselines3 import PPO

from quadpend_gym.scenarios import find_scenario
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import time_limit, validation
from quadpend_train.training import train as training
from quadpend_train.training.settings import HybridSettings, TrainSettings
from quadpend_train.training.time_limit import TimeLimit
from quadpend_train.training.validation import read_curve
from tests.helpers.training import BRIEF, BRIEF_SAC, train_policy

ENDLESS = replace(BRIEF, total_timesteps=10**9)


@pytest.mark.parametrize(
    "settings", [replace(ENDLESS, save_freq=64), replace(BRIEF_SAC, save_freq=64)], ids=["ppo", "sac"]
)
def test_run_that_stopped_when_an_evaluation_was_due_goes_on(
    settings: TrainSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last evaluation is later than it was due."""
    settings = replace(settings, eval_freq=160, max_seconds=1e6)
    monkeypatch.setattr(TimeLimit, "reached", lambda _, evaluations=0: bool(evaluations) and next(answers, True))
    answers = iter([False])
    train_policy(settings, tmp_path)
    curve = [score.steps for score in read_curve(tmp_path)]
    assert len(curve) == 2
    training.extend(tmp_path, 64, progress=False)
    assert [score.steps for score in read_curve(tmp_path)][:2] == curve


def test_run_that_stopped_before_its_only_gradient_steps_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TimeLimit, "reached", lambda limit, _=0: limit._last is not None)
    policy = train_policy(replace(BRIEF, total_timesteps=16, max_seconds=1e6), tmp_path)
    assert policy.card["stopped_by"] == "max_seconds"
    command = f"`quadpend train --resume {tmp_path} --more-steps 256` continues it"
    assert f"max_seconds ended the training early, after 16 of 16 timesteps: {command}" in capsys.readouterr().out


class Clock:
    """A clock that stands still, except in functions that take a declared time."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.now, self.patch = 1000.0, patch
        patch.setattr(time, "perf_counter", lambda: self.now)

    def declare(self, owner: Any, name: str, seconds: float) -> None:
        """Let each call of a function, or each step of an iterator that it returns, take so many seconds."""
        original = getattr(owner, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            result = original(*arguments, **options)
            if isinstance(result, Iterator):
                return self._timed_steps(result, seconds)
            self.now += seconds
            return result

        self.patch.setattr(owner, name, timed)

    def _timed_steps(self, steps: Iterator[Any], seconds: float) -> Iterator[Any]:
        for step in steps:
            self.now += seconds
            yield step


@pytest.mark.parametrize("imitation", [0, 10**6], ids=["training", "imitation"])
def test_whole_run_takes_max_seconds(imitation: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations are slow: the two after training take a third of the time, and there is no time for one before."""
    hybrid, scenario = HybridSettings("flatness", imitation_timesteps=imitation), '{"wind": "windy", "duration": 0.5}'
    settings = replace(ENDLESS, scenarios=(scenario,), max_seconds=60.0, eval_freq=3072, save_freq=10**6, hybrid=hybrid)
    evaluation, clock = 10.0, Clock(monkeypatch)
    clock.declare(SB3VecEnv, "step_wait", 0.05)
    clock.declare(PPO, "train", 1.0)
    clock.declare(validation, "run_episodes", evaluation)
    clock.declare(time_limit, "rollout", evaluation / find_scenario(scenario).steps)
    start = clock.now
    policy = train_policy(settings, tmp_path)
    assert 50.0 < clock.now - start < 62.0
    assert policy.card["stopped_by"] == "max_seconds"
    assert policy.card["steps"] == read_curve(tmp_path)[-1].steps
    training.extend(tmp_path, 64, progress=False)


def test_seconds_before_the_call_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command line counts from its own start: here all the time is over, so training takes one step."""
    started = time.perf_counter() - 100.0
    path = training.train(replace(ENDLESS, max_seconds=50.0), tmp_path, progress=False, started=started)
    assert MlpPolicy.load(path).card["steps"] == ENDLESS.num_envs
    assert MlpPolicy.load(path).card["stopped_by"] == "max_seconds"
    command = f"`quadpend train --resume {tmp_path} --more-steps 999999984` continues it"
    line = f"max_seconds ended the training early, after 16 of 1000000000 timesteps: {command}.\n"
    assert line in capsys.readouterr().out


def test_training_stops_before_the_predicted_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(time_limit, "time", SimpleNamespace(perf_counter=lambda: now))
    limit = TimeLimit(100.0)
    limit.evaluated(10.0)
    for time_of_step in (50.0, 52.0, 53.0):
        now = time_of_step
        limit.step()
    assert not limit.reached()
    now = 86.0
    assert not limit.reached()
    assert limit.reached(evaluations=1)
    now = 87.0  # the score takes 11 s, the interval 2 s
    assert limit.reached()
    limit.start_rollout()
    limit.start_rollout()
    assert not limit.reached()
    now = 1e9
    assert not TimeLimit(0.0).reached()
