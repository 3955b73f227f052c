"""Overhead of a Ray cluster on this machine against the process pool, on cells of about a second or longer.

Both run the same cells with the same number of processes. The clock runs from the first result to the last one, so the
start of the workers does not count: Ray keeps its workers between two studies, and the process pool does not.

    python -m benchmarks.cluster --jobs 2
"""

import argparse
import json
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from statistics import median

from quadpend_gym.scenarios import find_scenario
from quadpend_train.common.executors import Call, executor, run
from quadpend_train.evaluation.jobs import Job
from quadpend_train.policies.loading import load_policies

SCENARIOS, POLICIES = ("calm", "windy", "noisy", "gusts"), ("flatness", "lqr", "adrc-paper", "ppo-gain-scheduling-0")


def cells(episodes: int) -> dict[tuple[str, str], Job]:
    """Return the cells of the study."""
    found, policies = (
        {name: find_scenario(name) for name in SCENARIOS},
        {name: load_policies(name) for name in POLICIES},
    )
    return {(name, policy): Job(policies[policy], found[name], episodes, 0) for name in found for policy in policies}


def seconds(pool: Executor, calls: Mapping[tuple[str, str], Call]) -> float:
    """Return the time from the first result to the last one, s, so that the start of the workers does not count."""
    ends: list[float] = []
    run(calls, pool, done=lambda name, result: ends.append(time.perf_counter()))
    return ends[-1] - ends[0]


def measure(jobs: int, episodes: int, repetitions: int) -> dict[str, float]:
    """Return the median times of both executors, s, and the overhead of Ray."""
    import ray

    calls = cells(episodes)
    for call in calls.values():
        call()  # loads the kernels
    begin = time.perf_counter()
    for call in calls.values():
        call()
    alone = (time.perf_counter() - begin) / len(calls)
    ray.init("local", num_cpus=jobs, include_dashboard=False, log_to_driver=False)
    engines: dict[str, Executor] = {"processes": executor(jobs), "ray": executor(cluster="local")}
    measured: dict[str, list[float]] = {name: [] for name in engines}
    for repetition in range(repetitions + 1):
        for name, pool in engines.items():
            found = seconds(pool, calls)
            if repetition:  # the first study loads the kernels in the workers of Ray
                measured[name].append(found)
    times = {name: median(values) for name, values in measured.items()}
    return {"cell": alone, **times, "overhead": times["ray"] / times["processes"] - 1.0}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=partial(argparse.RawDescriptionHelpFormatter))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found = measure(options.jobs, options.episodes, options.repetitions)
    print(json.dumps(found, indent=1))
    ratio = found["ray"] / found["processes"]
    print(f"{found['cell']:.2f} s a cell; the time of Ray is {ratio:.2f} of that of {options.jobs} processes")
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
