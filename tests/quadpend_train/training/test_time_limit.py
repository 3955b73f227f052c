"""`max_seconds` counts everything from the start to the policy: set-up, imitation, evaluations, score and saving."""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import time_limit, validation
from quadpend_train.training import train as training
from quadpend_train.training.settings import HybridSettings
from quadpend_train.training.time_limit import TimeLimit
from quadpend_train.training.validation import read_curve
from tests.helpers.training import BRIEF, train_policy

ENDLESS = replace(BRIEF, total_timesteps=10**9)


@pytest.mark.parametrize("imitation", [0, 10**6], ids=["training", "imitation"])
def test_whole_run_takes_max_seconds(imitation: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An evaluation of a good policy is slow: here each takes half a second."""
    validate: Any = validation.validate
    hybrid = HybridSettings("flatness", imitation_timesteps=imitation)
    settings = replace(ENDLESS, max_seconds=4.0, eval_freq=2048, save_freq=10**6, hybrid=hybrid)

    def slow(*arguments: Any) -> Any:
        time.sleep(0.5)
        return validate(*arguments)

    monkeypatch.setattr("quadpend_train.training.callbacks.validate", slow)
    monkeypatch.setattr(training, "validate", slow)
    train_policy(
        replace(settings, total_timesteps=16, hybrid=HybridSettings()), tmp_path / "warm"
    )  # imports and kernels
    start = time.perf_counter()
    policy = train_policy(settings, tmp_path / "run")
    assert 2.0 < time.perf_counter() - start < 8.0  # of a busy machine too
    assert policy.card["steps"] == read_curve(tmp_path / "run")[-1].steps
    training.extend(tmp_path / "run", 64, progress=False)


def test_seconds_before_the_call_count(tmp_path: Path) -> None:
    """The command line counts from its own start: here all the time is over, so training takes one step."""
    started = time.perf_counter() - 100.0
    path = training.train(replace(ENDLESS, max_seconds=50.0), tmp_path, progress=False, started=started)
    assert MlpPolicy.load(path).card["steps"] == ENDLESS.num_envs


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
