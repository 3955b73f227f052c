"""Measures of the experiments: settling times and recovery, tolerated delays, and the time of a call."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.episodes import TEST_SEED, EpisodeResults, run_episodes
from quadpend_train.evaluation.statistics import Interval, mean, proportion

SETTLED_ERROR = 0.05  # m
REST = 1.0  # s at the end of an episode, during which the error must be below the limit


def settling_times(survived: Booleans, error: Any, period: float, limit: float = SETTLED_ERROR) -> Floats:
    """Return the time after which the error stays below `limit`, s, shape (s, n).

    It is nan for an episode that has not settled: after a fall, or if the error is not below the limit during the last
    second, or during the whole of a shorter episode. The error after each step has the shape (s, n, T), in m.
    """
    outside = ~(error < limit)
    steps = outside.shape[-1]
    last = np.where(outside.any(axis=-1), steps - np.argmax(outside[..., ::-1], axis=-1), 0)  # steps until it stays
    settled = survived & (last <= max(steps - round(REST / period), 0))
    return np.where(settled, period * last, np.nan)


def recovery(results: EpisodeResults, period: float, limit: float = 0.1) -> tuple[Interval, Interval]:
    """Return the share of episodes that settle, %, and the mean of their settling times, s."""
    times = settling_times(results.survived, results.error, period, limit)
    return proportion(~np.isnan(times)).scaled(100.0), mean(times)


def delay_budget(
    policy: Policy,
    scenario: Scenario,
    episodes: int = 100,
    seed: int = TEST_SEED,
    survival: float = 0.99,
    longest: float = 0.1,
) -> float:
    """Return the smallest additional latency, s, at which a policy survives less than a share of its episodes.

    The policy is designed for the scenario and does not know the additional latency, which is a whole number of
    substeps. The latency is first doubled and then bisected, as if survival never grew with it. The result is 0 if the
    share is not reached without an additional latency, and infinite if it is with `longest` (s).
    """
    substep = scenario.period / scenario.simulation.substeps

    def survives(substeps: int) -> bool:
        late = replace(scenario, latency=scenario.latency + substeps * substep)
        return bool(run_episodes([policy], late, episodes, seed, known=scenario).survived.mean() >= survival)

    if not survives(0):
        return 0.0
    tolerated, last = 0, round(longest / substep)
    late = min(1, last)
    while survives(late):
        if late == last:
            return np.inf
        tolerated, late = late, min(2 * late, last)
    while late - tolerated > 1:
        middle = (tolerated + late) // 2
        tolerated, late = (middle, late) if survives(middle) else (tolerated, middle)
    return late * substep


def call_time(policy: Policy, scenario: Scenario, calls: int = 300) -> float:
    """Return the median time of `predict` for one row in a scenario, s.

    It is that of one core if the libraries for linear algebra use one thread (OMP_NUM_THREADS=1).
    """
    flown = policy.adapt(scenario)
    env = flown.wrap(scenario.make_vec(1))
    observation, _ = env.reset(seed=0)
    memory, started, times = None, np.ones(1, np.bool_), []
    for _ in range(calls):
        begin = time.perf_counter()
        action, memory = flown.predict(observation, memory, started, deterministic=True)
        times.append(time.perf_counter() - begin)
        observation, _, terminated, truncated, _ = env.step(action)
        started = terminated | truncated
    return float(np.median(times))
