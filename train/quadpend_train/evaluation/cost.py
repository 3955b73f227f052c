"""What a policy costs: the time of one call."""

import time

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario


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
