"""docs/benchmarks/time_to_beat.md: training time until a policy reaches a goal, over several training seeds.

    python -m benchmarks.time_to_beat      # five training seeds; about half an hour

During a training, the deterministic policy is evaluated at regular intervals, in episodes that no training uses; the
time excludes these evaluations, imports and compilation. A run is evaluated many times and could reach a goal by
chance, so a goal counts only if the same policy also reaches it in a second block of episodes. The goals:

- balanced: the policy survives 95 % of the episodes in wind.
- paper: its penalised RMSE in wind is smaller than that of the paper's ADRC in the same episodes.
- classical: its penalised RMSE is smaller than that of `flatness` over all training scenarios, by a paired 95 %
  interval that excludes zero, and it survives at least as many episodes.

The steps are control steps of the policy, with those of imitation and without those of the baseline copies of a
baseline-relative reward.
"""

import argparse
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from benchmarks import speed
from experiments.pages import DOCS
from quadpend_baselines import Policy, controller
from quadpend_gym.scenarios import SETS
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.evaluation.statistics import mean
from quadpend_train.policies.export import export
from quadpend_train.training.settings import TrainSettings, read_settings
from quadpend_train.training.train import train

EPISODES = 100  # in each block
BLOCK_SEEDS = (VALIDATION_SEED, VALIDATION_SEED + 10_000)  # seed of the first episode of each block
Check = Callable[[Policy], bool]  # whether a policy reaches a goal in one block of episodes


class Goal(NamedTuple):
    """Settings of the training, environment steps between two evaluations, target (s), and the check of a block."""

    settings: str
    interval: int
    target: float
    make_check: Callable[[int], Check]


class GoalTime(NamedTuple):
    """Wall-clock time, s, and control steps until a training reached a goal; infinite if it did not."""

    seconds: float
    steps: float


def _balanced(seed: int) -> Check:
    return lambda policy: bool(run_episodes([policy], "windy", EPISODES, seed).survived.mean() >= 0.95)


def _better_than_paper(seed: int) -> Check:
    paper = run_episodes([controller("adrc-paper")], "windy", EPISODES, seed)

    def check(policy: Policy) -> bool:
        results = run_episodes([policy], "windy", EPISODES, seed)
        return bool(results.penalised_rmse.mean() < paper.penalised_rmse.mean())

    return check


def _better_than_classical(seed: int) -> Check:
    classical = [run_episodes([controller("flatness")], name, EPISODES, seed) for name in SETS["training"]]

    def check(policy: Policy) -> bool:
        results = [run_episodes([policy], name, EPISODES, seed) for name in SETS["training"]]
        pairs = list(zip(results, classical, strict=True))
        difference = sum(mine.penalised_rmse - theirs.penalised_rmse for mine, theirs in pairs)
        survival = sum(mine.survived.mean() - theirs.survived.mean() for mine, theirs in pairs)
        return bool(mean(np.asarray(difference)).high < 0.0 and survival >= 0.0)

    return check


GOALS = {
    "balanced": Goal("fast", 100_000, 15.0, _balanced),
    "balanced without imitation": Goal("ppo-alone", 50_000, 25.0, _balanced),
    "paper": Goal("fast", 250_000, 45.0, _better_than_paper),
    "classical": Goal("ppo-gain-scheduling", 100_000, 1200.0, _better_than_classical),
}


class _GoalCallback(BaseCallback):
    """Check at intervals whether the policy reaches a goal, and end the training when it does."""

    def __init__(self, settings: TrainSettings, interval: int, blocks: list[Check]) -> None:
        super().__init__()
        self.settings, self.interval, self.blocks = settings, interval, blocks
        self.reached = GoalTime(np.inf, np.inf)
        self.paused, self.start = 0.0, time.perf_counter()
        # An untrained policy is not evaluated, unless it has learned by imitation.
        self.next = 0 if settings.hybrid.imitation_timesteps else interval

    def _on_rollout_start(self) -> None:
        if self.num_timesteps < self.next:
            return
        self.next = self.num_timesteps + self.interval
        now = time.perf_counter()
        policy = export(self.model, **self.settings.policy_interface())
        if all(check(policy) for check in self.blocks):
            hybrid = self.settings.hybrid
            steps = float(self.num_timesteps * hybrid.action_repeat + hybrid.imitation_timesteps)
            self.reached = GoalTime(now - self.start - self.paused, steps)
        self.paused += time.perf_counter() - now

    def _on_step(self) -> bool:
        return self.reached.seconds == np.inf


def measure(seeds: int) -> dict[str, list[GoalTime]]:
    """Train for each goal with seeds from 0, and return when it is reached, one value for each training seed."""
    times: dict[str, list[GoalTime]] = {name: [] for name in GOALS}
    for name, goal in GOALS.items():
        checks = [goal.make_check(seed) for seed in BLOCK_SEEDS]
        for seed in range(seeds):
            settings = replace(read_settings(goal.settings), seed=seed, eval_freq=0)
            callback = _GoalCallback(settings, goal.interval, checks)
            with tempfile.TemporaryDirectory() as folder:
                train(settings, Path(folder) / "run", progress=False, callbacks=[callback])
            times[name].append(callback.reached)
            print(f"{name}, seed {seed}: {times[name][-1].seconds:.1f} s", flush=True)
    return times


def markdown(times: dict[str, list[GoalTime]], rate: float) -> str:
    """Return medians and ranges over the training seeds as a page; `rate` is PPO's environment steps per second."""

    def median(values: Any, form: str) -> str:
        return f"{np.median(values):{form}} [{values.min():{form}}, {values.max():{form}}]"

    rows = []
    for name, runs in times.items():
        seconds, steps = np.array(runs).T
        goal, spent = GOALS[name], f"{median(steps / 1e6, '.2f')} M"
        rows.append([name, f"`{goal.settings}`", median(seconds, ".1f"), spent, f"≤ {goal.target:.0f} s"])
    headings = ["goal", "settings", "seconds, median [range]", "steps, median [range]", "target"]
    return f"""# Time to beat

{max(map(len, times.values()))} training seeds; each result is confirmed in a second block of {EPISODES} episodes.
[`time_to_beat.py`](../../benchmarks/time_to_beat.py) defines the goals; `python -m benchmarks.time_to_beat` measures.
{platform.machine()}, one process; PPO makes {rate / 1e3:.0f} k steps/s on it with the settings `ppo`.

{markdown_table(headings, rows)}
"""


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="number of training seeds, counted from 0")
    times = measure(parser.parse_args().seeds)
    rate = speed.measure_training(rounds=3)["PPO on QuadPendulum-v0 in wind"]
    write_text(DOCS / "benchmarks/time_to_beat.md", markdown(times, rate))


if __name__ == "__main__":
    main()
