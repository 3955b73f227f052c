"""Overhead of a Ray cluster on this machine against the process pool, on cells of about a second or longer.

Both run the same cells with the same number of processes. The clock runs from the first result to the last one, so the
start of the workers does not count: Ray keeps its workers between two studies, and the process pool does not.

    python -m benchmarks.cluster --jobs 2
"""

import json
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from statistics import median

from experiments import pages
from quadpend_gym.scenarios import find_scenario
from quadpend_train.common.executors import Call, executor, run
from quadpend_train.evaluation.jobs import Job
from quadpend_train.policies.loading import load_policies

SCENARIOS, POLICIES = ("calm", "windy", "noisy", "gusts"), ("flatness", "lqr", "adrc-paper", "ppo-gain-scheduling-0")
STUDIES = 5  # of which the median counts


def seconds(pool: Executor, calls: Mapping[tuple[str, str], Call]) -> float:
    """Return the time from the first result to the last one, s."""
    ends: list[float] = []
    run(calls, pool, done=lambda name, result: ends.append(time.perf_counter()))
    return ends[-1] - ends[0]


def main() -> None:
    """Measure and print."""
    options = pages.options(__doc__, 100)
    import ray

    policies = {name: load_policies(name) for name in POLICIES}
    calls = {
        (name, policy): Job(learner, find_scenario(name), options.episodes, options.seed)
        for name in SCENARIOS
        for policy, learner in policies.items()
    }
    ray.init("local", num_cpus=options.jobs, include_dashboard=False, log_to_driver=False)
    engines: dict[str, Executor] = {"processes": executor(options.jobs), "ray": executor(cluster="local")}
    for pool in engines.values():
        seconds(pool, calls)  # loads the kernels in the workers
    studies = [{name: seconds(pool, calls) for name, pool in engines.items()} for _ in range(STUDIES)]
    times = {name: median(study[name] for study in studies) for name in engines}
    print(json.dumps({**times, "overhead": times["ray"] / times["processes"] - 1.0}, indent=1))


if __name__ == "__main__":
    main()
