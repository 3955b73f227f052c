"""The fallback reduces the policy's action where actuators are late or the pendulum leans far."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.hybrid import BandwidthScheduling, Hybrid, HybridMemory, ResidualAction
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import find_scenario
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from tests.helpers.controllers import HybridPolicy
from tests.helpers.envs import make_vec

SAME_STEP = {"autoreset_mode": "SameStep"}
FIRST = np.ones(3, np.bool_)


def scheduling(fallback_gain: float = 1.0) -> Hybrid:
    return BandwidthScheduling("flatness", 0.5, fallback_gain)


def first_memory(hybrid: Hybrid, **reset: Any) -> HybridMemory:
    """Memory after the first observation of an episode."""
    observation, _ = make_vec(3, **SAME_STEP).reset(seed=0, **reset)
    return hybrid.observe(observation, None, FIRST)[1]


@pytest.mark.parametrize("kind", [ResidualAction, BandwidthScheduling])
@pytest.mark.parametrize(("score", "gain", "weight"), [(1.0, 1.0, 0.5), (1.5, 2.0, 0.1)])
def test_anomaly_score_weighs_the_action(kind: Any, score: float, gain: float, weight: float) -> None:
    action = np.tile(np.float32([0.2, -0.6, 0.4, 0.8]), (3, 1))
    hybrid = kind("flatness", 0.5, gain)
    memory = first_memory(hybrid)._replace(anomaly_score=np.full(3, score))
    applied, _ = hybrid.act(action, memory)
    expected, _ = kind("flatness", 0.5, 0.0).act(np.float32(weight) * action, memory)
    assert_allclose(applied, expected, atol=1e-6)


def test_leaning_pendulum_raises_the_score_which_decays_by_one_percent_a_step() -> None:
    hybrid = scheduling()
    leaning = first_memory(hybrid, options={"state": {"direction": (0.3, 0.4, np.sqrt(0.75))}})
    assert_allclose(leaning.anomaly_score, 0.5 / 0.2, rtol=1e-6)
    env = make_vec(3, **SAME_STEP)
    observation, _ = env.reset(seed=0)
    _, memory = hybrid.observe(observation, None, FIRST)
    action, memory = hybrid.act(np.zeros((3, 4), np.float32), memory._replace(anomaly_score=np.full(3, 5.0)))
    _, later = hybrid.observe(env.step(action)[0], memory, np.array([False, False, True]))
    assert_allclose(later.anomaly_score[:2], 0.99 * 5.0)
    assert later.anomaly_score[2] < 0.3, "a new episode starts with a new score"


def anomaly_scores(scenario: str) -> Floats:
    """Anomaly scores over two seconds of eight episodes, shape (200, 8)."""
    env = replace(find_scenario(scenario), duration=2.0).make_vec(8)
    steps = rollout(HybridPolicy(scheduling()), env, VALIDATION_SEED)
    return np.array([step.memory.anomaly_score for step in steps])


def test_late_actions_raise_the_score_within_half_a_second_and_wind_does_not() -> None:
    assert anomaly_scores("training_lagged")[50:].min() > 2.0
    assert np.median(anomaly_scores("windy")[50:]) < 0.5
    assert np.median(anomaly_scores("turbulence")[50:]) < 1.0
