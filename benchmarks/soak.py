"""Everything for an hour: random steps, resets, environments, training, and damaged files.

`make soak` runs this file as ``python -m benchmarks.soak`` in two processes and updates docs/soak.md. Each process does
its share of every part and then repeats the random steps until the time is over. What must not happen is a *finding*:
an observation that is not finite or not in its space, a reward outside [0, 1], a warning, an exception, a step of more
than a second of processor time, a damaged file that is not refused with one sentence, or memory that grows.
"""

import argparse
import datetime
import gc
import multiprocessing
import os
import queue
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from benchmarks import fuzz
from quadpend_gym import QuadPendulumEnv
from quadpend_train.common.documents import fill
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.training.settings import TrainSettings
from quadpend_train.training.train import train
from tests.helpers.random_settings import extreme_vector_env, usual_vector_env

PROCESSES = 2
STEPS, RESETS, ENVIRONMENTS, TIMESTEPS, MUTATIONS = 10**9, 10**5, 10**4, 10**7, 10**4  # of all processes together
STEPS_OF_A_CONFIGURATION = 300  # of each sub-environment
SECONDS_OF_A_CONFIGURATION = 10.0  # s of processor time, after which the next configuration begins
LARGEST_GROWTH = 1.0  # MB for each million steps
NOISE, STEPS_NOISE = 10.0, 50.0  # MB that the allocator may keep; of random steps, whose environments differ in size
_EXPECTED = ".*(the wind pushes with up to|the trajectory (needs|reaches))"  # warnings about settings, not about steps
LONGEST_STEP = 1.0  # s of processor time, for up to 1024 sub-environments
_WARM_UP = 100  # configurations, after which all compiled code is loaded
_ROWS = (1, 7, 64, 1024, 4096)
COUNTED = ("usual settings", "extreme settings", "settings refused", "terminations", "truncations")


class Outcome(NamedTuple):
    """What a part of the soak did in one process.

    Attributes:
        done: Number of steps, resets, environments, timesteps or mutations.
        findings: Descriptions of what went wrong.
        growth: Growth of the memory, MB.
        counts: What else was counted, see `COUNTED`.
    """

    done: int
    findings: list[str]
    growth: float
    counts: tuple[tuple[str, int], ...] = ()


def resident() -> float:
    """Return the resident memory of this process, MB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def random_env(seed: int, counts: Counter[str]) -> Any:
    """Return a vector environment with random settings, usual or extreme. Refused settings are drawn again."""
    random = np.random.default_rng([5, seed])
    extreme = bool(random.random() < 0.7)
    while True:
        rows = int(random.choice(_ROWS))
        try:
            env = extreme_vector_env(random, rows) if extreme else usual_vector_env(random, rows)
        except (ValueError, TypeError) as error:
            if "\n" in str(error):
                raise
            counts["settings refused"] += 1
        else:
            counts["extreme settings" if extreme else "usual settings"] += 1
            return env


def fly(seed: int, steps: int, counts: Counter[str]) -> tuple[int, str]:
    """Make random steps in an environment with random settings.

    Args:
        seed: Seed of the settings and of the actions.
        steps: Largest number of steps of each sub-environment.
        counts: To be increased by what happens, see `COUNTED`.

    Returns:
        Number of steps and the finding, empty if there is none.
    """
    done, end = 0, time.thread_time() + SECONDS_OF_A_CONFIGURATION
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=_EXPECTED)
        try:
            env = random_env(seed, counts)
            random, space = np.random.default_rng([6, seed]), env.observation_space
            observation, _ = env.reset(seed=seed)
            for _ in range(steps):
                action = random.uniform(-1.0, 1.0, (env.num_envs, 4)).astype(np.float32)
                if random.random() < 0.1:
                    action = np.sign(action)
                begin = time.thread_time()
                observation, reward, terminated, truncated, _ = env.step(action)
                seconds = time.thread_time() - begin
                if seconds > LONGEST_STEP * max(env.num_envs / 1024.0, 1.0) and done:  # the first step may compile
                    return done, f"seed {seed}: a step took {seconds:.1f} s"
                if not (np.isfinite(observation).all() and space.contains(observation)):
                    return done, f"seed {seed}: an observation is not finite or not in its space"
                if not ((reward >= 0.0) & (reward <= 1.0)).all():
                    return done, f"seed {seed}: a reward is not in [0, 1]"
                done += env.num_envs
                counts["terminations"] += int(terminated.sum())
                counts["truncations"] += int(truncated.sum())
                if time.thread_time() > end:
                    break
            env.close()
        except Exception as error:  # every exception is a finding
            return done, f"seed {seed}: {type(error).__name__}: {error}"
    return done, ""


def random_steps(process: int, steps: int) -> Outcome:
    """Make random steps in many environments; the memory counts when all kinds of kernels are loaded."""
    start: float | None = None
    findings: list[str] = []
    done = configuration = counted = 0
    counts: Counter[str] = Counter()
    while done < steps:
        made, finding = fly(process + PROCESSES * configuration, STEPS_OF_A_CONFIGURATION, counts)
        done, configuration = done + max(made, 1), configuration + 1
        findings += [finding] if finding else []
        if start is None and configuration >= _WARM_UP:
            start, counted = resident(), done
    growth = resident() - start if start else 0.0
    return Outcome(done, findings + _grown(growth, done - counted, STEPS_NOISE), growth, tuple(counts.items()))


def _grown(growth: float, steps: int, noise: float = NOISE) -> list[str]:
    """Return the finding that the memory grew too much in a number of steps, if it did."""
    grown = growth > max(LARGEST_GROWTH * steps / 1e6, noise)
    return [f"memory grew by {growth:.0f} MB in {steps:,} steps"] if grown else []


def _repeat(function: Callable[[int], Any], number: int) -> Outcome:
    """Call a function with 0, 1, …; an exception or a warning is a finding. Memory counts after the first tenth."""
    findings, start = [], resident()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=_EXPECTED)
        for index in range(number):
            try:
                function(index)
            except Exception as error:  # every exception is a finding
                findings.append(f"{index}: {type(error).__name__}: {error}")
            if index == number // 10:
                start = resident()
    growth = resident() - start
    return Outcome(number, findings + _grown(growth, number), growth)


def resets(process: int, number: int) -> Outcome:
    """Reset an environment in wind, with a new seed each time."""
    env = QuadPendulumEnv(wind="storm")
    return _repeat(lambda index: env.reset(seed=process + PROCESSES * index), number)


def environments(process: int, number: int) -> Outcome:
    """Make, step and close environments."""

    def make_and_close(index: int) -> None:
        env = QuadPendulumEnv(task=("track", "hover")[index % 2], wind=(None, "storm")[process % 2])
        env.reset(seed=index)
        env.step(np.zeros(4, np.float32))
        env.close()

    return _repeat(make_and_close, number)


def training(process: int, timesteps: int) -> Outcome:
    """Train PPO with evaluations; the memory counts after the first fifth of the rollouts."""
    settings = TrainSettings(seed=process, total_timesteps=timesteps, eval_freq=max(timesteps // 10, 1))
    memory = _Memory()
    with tempfile.TemporaryDirectory() as folder:
        try:
            train(settings, Path(folder) / "run", progress=False, callbacks=[memory])
        except Exception as error:  # every exception is a finding
            return Outcome(timesteps, [f"{type(error).__name__}: {error}"], 0.0)
    growth = memory.rollouts[-1] - memory.rollouts[len(memory.rollouts) // 5]
    return Outcome(timesteps, _grown(growth, timesteps), growth)


class _Memory(BaseCallback):
    """The resident memory at the end of each rollout, MB."""

    def __init__(self) -> None:
        super().__init__()
        self.rollouts: list[float] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.rollouts.append(resident())


def mutations(name: str, process: int, number: int) -> Outcome:
    """Damage files of one kind, see `benchmarks.fuzz`; the memory counts after the first tenth, as in `_repeat`."""
    seeds = range(process, process + PROCESSES * number, PROCESSES)
    with tempfile.TemporaryDirectory() as folder:
        findings = fuzz.fuzz(name, seeds[: number // 10], Path(folder))
        start = resident()
        findings += fuzz.fuzz(name, seeds[number // 10 :], Path(folder))
    growth = resident() - start
    return Outcome(number, findings + _grown(growth, number), growth)


def parts(process: int, scale: float) -> Iterator[tuple[str, Outcome]]:
    """Run all parts in one process and yield their outcomes by name.

    Args:
        process: Number of the process; it selects the seeds.
        scale: Share of the numbers of this module.
    """

    def share(number: int) -> int:
        return max(int(number * scale) // PROCESSES, 1)

    for name in fuzz.TARGETS:
        yield f"damaged {name}", mutations(name, process, share(MUTATIONS))
    yield "resets", resets(process, share(RESETS))
    yield "environments made and closed", environments(process, share(ENVIRONMENTS))
    yield "timesteps of training", training(process, share(TIMESTEPS))
    yield "random steps", random_steps(process, share(STEPS))


def run_process(process: int, seconds: float, scale: float, results: Any) -> None:
    """Run all parts once, then random steps until the time is over, and put all outcomes into `results`."""
    try:
        _run_all(process, seconds, scale, results)
    finally:
        results.put(None)


def _run_all(process: int, seconds: float, scale: float, results: Any) -> None:
    end = time.monotonic() + seconds
    for item in parts(process, scale):
        results.put(item)
    configuration = process + PROCESSES * 10**6
    done, findings, start = 0, [], resident()
    counts: Counter[str] = Counter()
    while time.monotonic() < end:
        made, finding = fly(configuration, STEPS_OF_A_CONFIGURATION, counts)
        done, configuration = done + made, configuration + PROCESSES
        findings += [finding] if finding else []
    growth = resident() - start
    results.put(
        (
            "random steps until the end",
            Outcome(done, findings + _grown(growth, done, STEPS_NOISE), growth, tuple(counts.items())),
        )
    )


def table(outcomes: dict[str, list[Outcome]]) -> str:
    """Return a Markdown table of the outcomes of all processes."""
    rows = []
    for name, group in outcomes.items():
        done = sum(item.done for item in group)
        growth = max(item.growth for item in group)
        rows.append([name, f"{done:,}", str(sum(len(item.findings) for item in group)), f"{growth:.1f}"])
    text = markdown_table(["part", "number", "findings", "largest growth of memory in a process (MB)"], rows)
    counts = sum((Counter(dict(item.counts)) for group in outcomes.values() for item in group), Counter[str]())
    return f"{text}\n\nThe random steps had {', '.join(f'{counts[name]:,} {name}' for name in COUNTED)}."


def run(seconds: float, scale: float, document: Path | None) -> int:
    """Run the soak in all processes, print the findings, update the page, and return the number of findings."""
    context = multiprocessing.get_context("spawn")
    results: Any = context.Queue()
    begin = time.monotonic()
    processes = [context.Process(target=run_process, args=(i, seconds, scale, results)) for i in range(PROCESSES)]
    for process in processes:
        process.start()
    outcomes: dict[str, list[Outcome]] = {}
    running = PROCESSES
    while running:
        try:
            item = results.get(timeout=60.0)
        except queue.Empty:
            if not any(process.is_alive() for process in processes):
                break  # a killed process; the exit codes below say so
            continue
        if item is None:
            running -= 1
            continue
        name, outcome = item
        outcomes.setdefault(name, []).append(outcome)
        print(f"{name}: {outcome.done:,}, {len(outcome.findings)} findings, {outcome.growth:.1f} MB", flush=True)
        for finding in outcome.findings[:20]:
            print(f"  {finding}", flush=True)
    for number, process in enumerate(processes):
        process.join()
        if process.exitcode:
            finding = f"process {number} ended with exit code {process.exitcode}"
            print(finding, flush=True)
            outcomes.setdefault("processes", []).append(Outcome(1, [finding], 0.0))
    minutes = (time.monotonic() - begin) / 60.0
    if document is not None:
        date = datetime.datetime.now(datetime.timezone.utc).date()
        fill(
            document,
            {"soak": f"{date}, `make soak`: {minutes:.0f} minutes in {PROCESSES} processes.\n\n{table(outcomes)}"},
        )
    return sum(len(item.findings) for group in outcomes.values() for item in group)


def main() -> None:
    """Read the command line and run; the exit status is 1 if there are findings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description="Run everything for an hour.")
    parser.add_argument("--minutes", type=float, default=60.0, help="least duration (default: 60)")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the usual numbers (default: 1)")
    parser.add_argument("--document", type=Path, help="page to update")
    arguments = parser.parse_args()
    raise SystemExit(min(run(60.0 * arguments.minutes, arguments.scale, arguments.document), 1))


if __name__ == "__main__":
    main()
