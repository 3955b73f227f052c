"""How a study scales: cells on the processes of this machine, memory of many rows, and a simulated cluster.

    python -m benchmarks.scale

A cell is one policy in one scenario. The benchmark measures the duration and the size of the results of the cells of a
study, the rate of cells on several processes and on a local Ray cluster, what the command needs for each cell, and
the memory of vector environments. From these it simulates a cluster of any size. It needs Ray (extra ``cluster``).
"""

import argparse
import heapq
import json
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.scenarios import find_scenario
from quadpend_train.common.executors import Executor, executor
from quadpend_train.common.files import write_text
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs

POLICIES = ("flatness", "lqr", "adrc-paper", "mppi", "ppo-gain-scheduling-0")
SCENARIOS = ("calm", "dryden_severe", "uncertain", "noisy")
EPISODES = 50
PROCESSES = (1, 2, 4)
ROWS = (1_000, 10_000, 100_000, 1_000_000)
WORKERS = (1, 10, 100, 300, 1000, 3000)
REPEATS = 200  # of the measured cells: five training seeds, four vehicles and ten scenarios instead of one, for example
BANDWIDTH = 125e6  # bytes/s at which the driver receives results: a network of 1 Gbit/s
_INSTANT = 500  # calls that return at once, for the time of the driver
SLOW_SHARE, SLOW_FACTOR = 0.05, 3.0  # share of the simulated workers that are slower by the factor


class Costs(NamedTuple):
    """What a cluster adds to the cells.

    Attributes:
        start: Time until the first result of a cluster that starts, s.
        driver: Processor time of the driver, the process of the command, for each cell, s.
        size: Bytes of the results of a cell.
    """

    start: float
    driver: float
    size: float


def cells(policies: Sequence[str], scenarios: Sequence[str], episodes: int) -> dict[tuple[str, str], Job]:
    """Return the cells of a study."""
    return {(name, policy): Job(policy, find_scenario(name), episodes, 0) for name in scenarios for policy in policies}


def measure_cells(study: Mapping[Any, Job]) -> list[float]:
    """Return the durations of the cells in this process, without compilation, s."""
    seconds = []
    for job in study.values():
        job._replace(episodes=1)()
        begin = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - begin)
    return seconds


def measure_executor(run: Executor, calls: Mapping[Any, Any]) -> tuple[float, float]:
    """Return the time until the first result and the time of all results, s."""
    begin, first = time.perf_counter(), 0.0
    for name, outcome in run(calls):
        if isinstance(outcome, Exception):
            raise RuntimeError(f"{name} failed") from outcome
        first = first or time.perf_counter() - begin
    return first, time.perf_counter() - begin


def measure_cluster(study: Mapping[Any, Job]) -> tuple[Costs, float]:
    """Run a study on a local Ray cluster with a worker on each core.

    The time of the driver is its processor time for a call that returns at once as many bytes as a cell, and for a file
    of the cache. It leaves out waits for the disk.

    Returns:
        The costs, and the duration of the study after the start of the workers, s.
    """
    run = executor(cluster="local")
    start, _ = measure_executor(run, dict(list(study.items())[:1]))
    for _ in range(2):  # the first time, all workers load the compiled code
        with TemporaryDirectory() as folder:
            begin = time.perf_counter()
            results = run_jobs(study, folder, processes=run)
            total = time.perf_counter() - begin
    size = float(np.mean([len(pickle.dumps(result)) for result in results.values()]))
    instant = {number: partial(bytes, round(size)) for number in range(_INSTANT)}
    before = time.process_time()
    measure_executor(run, instant)
    receive, before = (time.process_time() - before) / _INSTANT, time.process_time()
    with TemporaryDirectory() as folder:
        for number, result in enumerate(results.values()):
            cache.save(folder, str(number), result)
    return Costs(start, receive + (time.process_time() - before) / len(results), size), total


def simulate(seconds: Sequence[float], workers: int, costs: Costs, slow_share: float = 0.0, seed: int = 0) -> float:
    """Return the duration of a study on a simulated cluster, s.

    A free worker takes the next cell at once, since several cells for each worker are submitted in advance. The driver
    receives one result after the other, which takes its time for a cell and the transfer with `BANDWIDTH`.

    Args:
        seconds: Durations of the cells in their order.
        workers: Number of workers, one for each core.
        costs: What the cluster adds.
        slow_share: Share of workers on which a cell takes `SLOW_FACTOR` times as long.
        seed: Seed of the choice of these workers.
    """
    slow = np.random.default_rng(seed).permutation(workers) < round(slow_share * workers)
    free = [(costs.start, worker) for worker in range(workers)]
    ends = []
    for duration in seconds:
        begin, worker = heapq.heappop(free)
        ends.append(begin + duration * (SLOW_FACTOR if slow[worker] else 1.0))
        heapq.heappush(free, (ends[-1], worker))
    received = 0.0
    for end in sorted(ends):
        received = max(received, end) + costs.driver + costs.size / BANDWIDTH
    return received


def scale_table(seconds: Sequence[float], costs: Costs) -> str:
    """Return a Markdown table of the durations of a study on clusters of several sizes."""
    random = np.random.default_rng(0)
    study = random.permutation(np.tile(seconds, REPEATS)).tolist()
    missing = [duration for duration in study if random.random() < 0.5]
    work, rows = sum(study), []
    for workers in WORKERS:
        total = simulate(study, workers, costs)
        others = (
            simulate(sorted(study, reverse=True), workers, costs),
            simulate(study, workers, costs, SLOW_SHARE) if SLOW_SHARE * workers >= 1.0 else np.nan,
            simulate(missing, workers, costs),
        )
        row = [f"{workers:,}", f"{total:,.0f} s", f"{work / total:.0f}", f"{100.0 * work / total / workers:.0f} %"]
        rows.append(row + ["–" if np.isnan(value) else f"{value:,.0f} s" for value in others])
    head = ["workers", "duration", "speed-up", "efficiency"]
    return markdown_table([*head, "longest cells first", "5 % slow workers", "half of the cells cached"], rows)


_MEMORY = """
import sys, time, tracemalloc
import numpy as np
from quadpend_gym import QuadPendulumVectorEnv
rows, wind = int(sys.argv[1]), sys.argv[2] or None
small = QuadPendulumVectorEnv(1, wind=wind)
small.reset(seed=0)
small.step(np.zeros((1, 4), np.float32))  # compiles
tracemalloc.start()
env = QuadPendulumVectorEnv(rows, wind=wind)
env.reset(seed=0)
actions = np.zeros((rows, 4), np.float32)
env.step(actions)
peak = tracemalloc.get_traced_memory()[1]
tracemalloc.stop()
steps, begin = max(3, 300_000 // rows), time.perf_counter()
for _ in range(steps):
    env.step(actions)
rate = steps * rows / (time.perf_counter() - begin)
print(peak, rate)
"""


def memory_table(rows: Sequence[int]) -> str:
    """Return a Markdown table of the memory and the speed of vector environments, each in a process of its own."""
    lines = []
    for count in rows:
        line = [f"{count:,}"]
        for wind in ("", "windy"):
            command = [sys.executable, "-c", _MEMORY, str(count), wind]
            answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
            size, rate = map(float, answer)
            line += [f"{size / 1e6:.0f} MB", f"{size / count:.0f} B", f"{rate / 1e6:.1f} M"]
        lines.append(line)
    head = ["sub-environments", "calm: memory", "for each", "steps/s", "windy: memory", "for each", "steps/s"]
    return markdown_table(head, lines)


def measure(jobs: Mapping[Any, Job]) -> dict[str, Any]:
    """Return all measurements of cells and executors."""
    seconds = measure_cells(jobs)
    times = {n: measure_executor(executor(n), jobs) for n in PROCESSES}
    costs, cluster = measure_cluster(jobs)
    return {"cells": seconds, "processes": times, "costs": costs._asdict(), "ray": cluster, "cores": os.cpu_count()}


def tables(measured: Mapping[str, Any], rows: Sequence[int]) -> dict[str, str]:
    """Return the parts of the page."""
    seconds, costs = measured["cells"], Costs(**measured["costs"])
    alone = float(measured["processes"][PROCESSES[0]][1])
    lines = []
    for count, (first, total) in measured["processes"].items():
        lines.append([str(count), f"{len(seconds) / total:.2f}", f"{alone / total:.2f}", f"{first:.1f} s"])
    ray = f"Ray, {measured['cores']} workers that have started"
    lines.append([ray, f"{len(seconds) / measured['ray']:.2f}", f"{alone / measured['ray']:.2f}", "–"])
    quantities = [
        ["cells of the measured study", f"{len(seconds)}, of {EPISODES} episodes"],
        [
            "shortest, median and longest cell",
            f"{min(seconds):.2f} s, {np.median(seconds):.2f} s, {max(seconds):.1f} s",
        ],
        ["results of a cell", f"{costs.size / 1e3:.0f} kB"],
        ["first result of a local Ray cluster that starts", f"{costs.start:.1f} s"],
        ["processor time of the command for each cell", f"{1e3 * costs.driver:.1f} ms"],
    ]
    total = REPEATS * len(seconds), REPEATS * sum(seconds)
    return {
        "processes": markdown_table(["processes", "cells/s", "speed-up", "first result after"], lines),
        "costs": markdown_table(["quantity", "measured"], quantities),
        "cluster": f"{total[0]:,} cells, {total[1] / 3600.0:.1f} hours of one core:\n\n{scale_table(seconds, costs)}",
        "memory": memory_table(rows),
    }


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scale", description="Measure how a study scales.")
    parser.add_argument("--out", type=Path, help="JSON file for the measurements")
    arguments = parser.parse_args()
    measured = measure(cells(POLICIES, SCENARIOS, EPISODES))
    if arguments.out:
        write_text(arguments.out, json.dumps(measured, indent=1) + "\n")
    for table in tables(measured, ROWS).values():
        print(f"{table}\n")


if __name__ == "__main__":
    main()
