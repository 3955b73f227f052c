"""Everything for an hour: random steps, environments and training.

`make soak` runs this file in two processes and updates docs/soak.md. What must not happen is a *finding*: an
observation that is not finite or not in its space, a reward outside [0, 1], a warning, an exception, a step of more
than a second of processor time, or memory that grows.
"""

import argparse
import datetime
import gc
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.pages import fill
from quadpend_gym import QuadPendulumEnv
from quadpend_train.common import executors
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.training.settings import TrainSettings
from quadpend_train.training.train import train
from tests.helpers.random_settings import random_scenario

PROCESSES = 2
STEPS, ENVIRONMENTS, TIMESTEPS = 10**9, 10**4, 10**7  # of all processes together
STEPS_OF_A_CONFIGURATION = 300  # of each sub-environment
SECONDS_OF_A_CONFIGURATION = 10.0  # s of processor time, after which the next configuration begins
LARGEST_GROWTH = 1.0  # MB for each million steps
NOISE, STEPS_NOISE = 10.0, 50.0  # MB that the allocator may keep; of random steps, whose environments differ in size
LONGEST_STEP = 1.0  # s of processor time, for up to 1024 sub-environments
_EXPECTED = ".*(the wind pushes with up to|the trajectory (needs|reaches))"  # warnings about settings, not about steps
_WARM_UP = 100  # configurations, after which all compiled code is loaded
ROWS = (1, 7, 64, 1024, 4096)


class Outcome(NamedTuple):
    """What a part of the soak did in one process."""

    done: int  # number of steps, environments or timesteps
    findings: list[str]  # descriptions of what went wrong
    growth: float  # of the memory, MB


def resident() -> float:
    """Return the resident memory of this process, MB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def grown(growth: float, steps: int, noise: float = NOISE) -> list[str]:
    """Return the finding that the memory grew too much in a number of steps, if it did."""
    large = growth > max(LARGEST_GROWTH * steps / 1e6, noise)
    return [f"memory grew by {growth:.0f} MB in {steps:,} steps"] if large else []


def fly(seed: int, steps: int) -> int:
    """Make up to `steps` random steps of each sub-environment with random settings, and return how many were made."""
    random, done, end = np.random.default_rng([5, seed]), 0, time.thread_time() + SECONDS_OF_A_CONFIGURATION
    env = random_scenario(random).make_vec(int(random.choice(ROWS)))
    env.reset(seed=seed)
    for _ in range(steps):
        action = random.uniform(-1.0, 1.0, (env.num_envs, 4)).astype(np.float32)
        begin = time.thread_time()
        observation, reward, *_ = env.step(np.sign(action) if random.random() < 0.1 else action)
        seconds = time.thread_time() - begin
        # The first step may compile.
        assert not done or seconds < LONGEST_STEP * max(env.num_envs / 1024.0, 1.0), f"a step took {seconds:.1f} s"
        assert np.isfinite(observation).all(), "an observation is not finite"
        assert env.observation_space.contains(observation), "an observation is not in its space"
        assert ((reward >= 0.0) & (reward <= 1.0)).all(), "a reward is not in [0, 1]"
        done += env.num_envs
        if time.thread_time() > end:
            break
    env.close()
    return done


def found(call: Callable[[], Any]) -> tuple[Any, list[str]]:
    """Return the result of a call, None if it failed, and the finding. A warning is a finding too."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=_EXPECTED)
        try:
            return call(), []
        except Exception as error:  # every exception is a finding
            return None, [f"{type(error).__name__}: {error}"[:300]]


def random_steps(steps: int, end: float, process: int) -> Outcome:
    """Make random steps in many environments, at least until a time; the memory counts after `_WARM_UP` of them."""
    start, counted, done, configuration, findings = 0.0, 0, 0, 0, []
    while done < steps or time.time() < end:
        seed = process + PROCESSES * configuration
        made, finding = found(partial(fly, seed, STEPS_OF_A_CONFIGURATION))
        done, configuration = done + max(made or 0, 1), configuration + 1
        findings += [f"seed {seed}: {text}" for text in finding]
        if configuration == _WARM_UP:
            start, counted = resident(), done
    growth = resident() - start if start else 0.0
    return Outcome(done, findings + grown(growth, done - counted, STEPS_NOISE), growth)


def repeat(function: Callable[[int], Any], number: int, process: int) -> Outcome:
    """Call a function with the seeds of a process. The memory counts after the first tenth."""
    findings, start = [], resident()
    for index in range(number):
        seed = process + PROCESSES * index
        findings += [f"seed {seed}: {text}" for text in found(partial(function, seed))[1]]
        if index == number // 10:
            start = resident()
    growth = resident() - start
    return Outcome(number, findings + grown(growth, number), growth)


def make_and_close(seed: int) -> None:
    """Make an environment, reset it ten times, step and close it."""
    env = QuadPendulumEnv(task=("track", "hover")[seed // 2 % 2], wind=(None, "storm")[seed % 2])
    for number in range(10):
        env.reset(seed=10 * seed + number)
    env.step(np.zeros(4, np.float32))
    env.close()


def training(timesteps: int, process: int) -> Outcome:
    """Train PPO with evaluations twice; the memory counts in the second half."""
    settings = TrainSettings(seed=process, total_timesteps=timesteps // 2, eval_freq=max(timesteps // 10, 1))
    findings, start = [], 0.0
    for _ in range(2):
        start = resident()
        with tempfile.TemporaryDirectory() as folder:
            findings += found(partial(train, settings, Path(folder, "run"), progress=False))[1]
    growth = resident() - start
    return Outcome(timesteps, findings + grown(growth, timesteps), growth)


def parts(scale: float) -> dict[tuple[str, int], Callable[[], Outcome]]:
    """Return all parts of all processes by name and process, for a share of the numbers of this module."""

    def share(number: int) -> int:
        return max(int(number * scale) // PROCESSES, 1)

    made: dict[str, Callable[[int], Outcome]] = {
        "environments made and closed": partial(repeat, make_and_close, share(ENVIRONMENTS)),
        "timesteps of training": partial(training, share(TIMESTEPS)),
        "random steps": partial(random_steps, share(STEPS), time.time() + 3600.0 * scale),
    }
    return {(name, i): partial(part, i) for name, part in made.items() for i in range(PROCESSES)}


def table(outcomes: Mapping[str, list[Outcome]]) -> str:
    """Return a Markdown table of the outcomes of all processes."""
    rows = []
    for name, group in outcomes.items():
        done, growth = sum(item.done for item in group), max(item.growth for item in group)
        rows.append([name, f"{done:,}", str(sum(len(item.findings) for item in group)), f"{growth:.1f}"])
    return markdown_table(["part", "number", "findings", "largest growth of memory in a process (MB)"], rows)


def main() -> None:
    """Run the soak, print the findings, and update the page; the exit status is 1 if there are findings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description="Run everything for an hour.")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the usual numbers and time (default: 1)")
    parser.add_argument("--document", type=Path, help="page to update")
    options = parser.parse_args()
    begin = time.time()
    outcomes: dict[str, list[Outcome]] = {}

    def show(name: tuple[str, int], outcome: Outcome) -> None:
        outcomes.setdefault(name[0], []).append(outcome)
        print(f"{name[0]}: {outcome.done:,}, {len(outcome.findings)} findings, {outcome.growth:.1f} MB", flush=True)
        print("".join(f"  {finding}\n" for finding in outcome.findings[:20]), end="", flush=True)

    executors.run(parts(options.scale), PROCESSES, done=show, what="part")
    print(text := table(outcomes))
    if options.document:
        date, minutes = datetime.datetime.now(datetime.timezone.utc).date(), (time.time() - begin) / 60.0
        head = f"{date}, `make soak`: {minutes:.0f} minutes in {PROCESSES} processes."
        fill(options.document, {"soak": f"{head}\n\n{text}"})
    raise SystemExit(any(item.findings for group in outcomes.values() for item in group))


if __name__ == "__main__":
    main()
