"""Trials per minute of `quadpend tune` with one and with two processes on one storage.

    python -m benchmarks.shared_search

Episodes do not end early in the scenario, so that all trials take the same time. It runs from the beginning of the
first trial to the end of the last one: the start of the processes and the final score of the gains do not count. Run it
on an idle machine.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.studies.search.shared_trials import finished_trials
from quadpend_train.studies.search.tuning import open_search

LIMITS = '{"pendulum_angle": 3.14159, "body_angle": 3.14159, "tracking_error": 1e9, "ground": -1e9}'
SCENARIOS = ('{"wind": "windy", "task": {"limits": ' + LIMITS + "}}",)
EPISODES = 16


def rate(controller: str, processes: int, trials: int, seed: int) -> float:
    """Return the finished trials per minute of a search by some processes that start together."""
    with TemporaryDirectory() as folder:
        storage = str(Path(folder, "trials.log"))
        options = [controller, "--trials", str(trials), "--episodes", str(EPISODES), "--seed", str(seed)]
        command = [sys.executable, "-m", "quadpend_train", "tune", *options, "--scenarios", *SCENARIOS]
        outputs = [["--storage", storage, "--out", str(Path(folder, str(number)))] for number in range(processes)]
        null = subprocess.DEVNULL
        running = [subprocess.Popen([*command, *output], stdout=null, stderr=null) for output in outputs]
        statuses = [process.wait() for process in running]
        if any(statuses):
            raise RuntimeError("a process failed")
        done = finished_trials(open_search(controller, EPISODES, seed, SCENARIOS, storage))
        begin = min(trial.datetime_start for trial in done if trial.datetime_start)
        end = max(trial.datetime_complete for trial in done if trial.datetime_complete)
        return 60.0 * len(done) / (end - begin).total_seconds()


def table(rates: Mapping[int, Sequence[float]]) -> str:
    """Return a Markdown table with a row for each number of processes."""
    ratios = {processes: np.divide(values, rates[1]) for processes, values in rates.items()}
    rows = [
        [str(n), f"{np.median(rates[n]):.0f}", f"{np.median(ratio):.2f} [{ratio.min():.2f}, {ratio.max():.2f}]"]
        for n, ratio in ratios.items()
    ]
    return markdown_table(["processes", "trials per minute", "ratio, median [range]"], rows)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shared_search", description=__doc__)
    parser.add_argument("--controller", default="lqr")
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--repetitions", type=int, default=5)
    options = parser.parse_args()
    rates: dict[int, list[float]] = {1: [], 2: []}
    for repetition in range(options.repetitions):
        for processes, values in rates.items():
            values.append(rate(options.controller, processes, options.trials, repetition))
            print(f"{processes} processes: {values[-1]:.1f} trials per minute", file=sys.stderr, flush=True)
    print(table(rates))


if __name__ == "__main__":
    main()
