"""Training time until a policy reaches a goal: wall-clock time and environment steps, over several training seeds.

Run it by ``python -m benchmarks.time_to_beat --out docs/time_to_beat.json``. During a training, the
deterministic policy is evaluated at regular intervals, in episodes that no training uses. The time excludes these
evaluations. The goals are:

- balanced: the policy survives 95 % of the episodes in wind.
- paper: its penalised RMSE in wind, which counts a fall as 1 m, is smaller than that of the paper's ADRC in the same
  episodes.
- classical: its penalised RMSE is smaller than that of `flatness` over all training scenarios, by a
  paired 95 % interval that excludes zero, and it survives at least as many episodes.

A run is evaluated many times and could reach a goal by chance. A goal therefore counts only if the same policy also
reaches it in a second block of episodes. The first two goals are measured in one training of a PPO policy that
observes the estimates of the flatness-based controller and first imitates this controller (settings ``fast``), the
first one also without imitation (settings ``ppo-alone``). The third is measured with a hybrid (settings
``ppo-gain-scheduling``), which is close to its base controller, ``flatness``, from the start. The time
includes making the environment and imitation, and excludes imports and compilation. The steps are control steps of
the policy. They include those of the imitation and exclude those of the baseline copies of a baseline-relative
reward.
"""

import argparse
import json
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
from quadpend_baselines import Policy, controller
from quadpend_gym.scenarios import SETS
from quadpend_train.common.files import to_json_data
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.statistics import mean
from quadpend_train.policies.export import export
from quadpend_train.training.settings import TrainSettings, read_settings
from quadpend_train.training.train import train

EPISODES = 100  # in each block
BLOCK_SEEDS = (VALIDATION_SEED, VALIDATION_SEED + 10_000)  # seed of the first episode of each block
Check = Callable[[Policy], bool]  # whether a policy reaches a goal in one block of episodes


class Goal(NamedTuple):
    """A goal of a training.

    Attributes:
        settings: Name of the training settings, see `quadpend_train.training.settings`.
        interval: Environment steps between two evaluations.
        target: Time in which the goal should be reached, s.
        make_check: Function that takes the seed of a block of episodes and returns the check in that block.
    """

    settings: str
    interval: int
    target: float
    make_check: Callable[[int], Check]


class GoalTime(NamedTuple):
    """When a training reached a goal; both numbers are infinite if it did not.

    Attributes:
        seconds: Wall-clock time, s.
        steps: Control steps.
    """

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
    """Check at intervals which goals the policy reaches, and end the training when it has reached all of them."""

    def __init__(self, settings: TrainSettings, checks: dict[str, tuple[int, list[Check]]]) -> None:
        super().__init__()
        self.settings, self.checks = settings, checks
        self.reached: dict[str, GoalTime] = {}
        self.paused, self.start = 0.0, time.perf_counter()
        # An untrained policy is not evaluated, unless it has learned by imitation.
        self.next = {
            name: 0 if settings.hybrid.imitation_timesteps else interval for name, (interval, _) in checks.items()
        }

    def _on_rollout_start(self) -> None:
        for name, (interval, blocks) in self.checks.items():
            if name in self.reached or self.num_timesteps < self.next[name]:
                continue
            self.next[name] = self.num_timesteps + interval
            now = time.perf_counter()
            policy = export(self.model, **self.settings.policy_interface())
            if all(check(policy) for check in blocks):
                hybrid = self.settings.hybrid
                steps = float(self.num_timesteps * hybrid.action_repeat + hybrid.imitation_timesteps)
                self.reached[name] = GoalTime(now - self.start - self.paused, steps)
            self.paused += time.perf_counter() - now

    def _on_step(self) -> bool:
        return len(self.reached) < len(self.checks)


def measure(seeds: int = 5, names: tuple[str, ...] = tuple(GOALS)) -> dict[str, list[GoalTime]]:
    """Train and return when each goal is reached, one value for each training seed.

    Args:
        seeds: Number of training seeds, counted from 0.
        names: Keys of `GOALS`.
    """
    goals = {name: GOALS[name] for name in names}
    checks = {name: [goal.make_check(seed) for seed in BLOCK_SEEDS] for name, goal in goals.items()}
    times: dict[str, list[GoalTime]] = {name: [] for name in names}
    for settings in dict.fromkeys(goal.settings for goal in goals.values()):
        wanted = {name: (goal.interval, checks[name]) for name, goal in goals.items() if goal.settings == settings}
        for seed in range(seeds):
            run_settings = replace(read_settings(settings), seed=seed, eval_freq=0, patience=0)
            callback = _GoalCallback(run_settings, wanted)
            with tempfile.TemporaryDirectory() as folder:
                train(run_settings, Path(folder) / "run", progress=False, callbacks=[callback])
            for name in wanted:
                times[name].append(callback.reached.get(name, GoalTime(np.inf, np.inf)))
                print(f"{name}, seed {seed}: {times[name][-1].seconds:.1f} s", flush=True)
    return times


def markdown(times: dict[str, list[GoalTime]], rate: float) -> str:
    """Format medians and ranges over the training seeds as a Markdown page.

    Args:
        times: Results of `measure`.
        rate: PPO's environment steps per second on this machine.
    """
    lines = [
        "# Time to beat",
        "",
        f"{max(map(len, times.values()))} training seeds; each result is confirmed in a second block of {EPISODES}"
        " episodes. `python -m benchmarks.time_to_beat` measures this on your machine.",
        "[`time_to_beat.py`](../benchmarks/time_to_beat.py) defines the goals.",
        f"{platform.machine()}, one process; PPO makes {rate / 1e3:.0f} k steps/s on it with the settings `ppo`.",
        "",
        "| goal | settings | seconds, median [range] | steps, median [range] | target |",
        "|---|---|---|---|---|",
    ]
    for name, runs in times.items():
        seconds, steps = (np.array(values) for values in zip(*runs, strict=True))
        goal = GOALS[name]
        lines.append(
            f"| {name} | `{goal.settings}` | {_median_and_range(seconds, '.1f')}"
            f" | {_median_and_range(steps / 1e6, '.2f')} M | ≤ {goal.target:.0f} s |"
        )
    return "\n".join(lines) + "\n"


def _median_and_range(values: Any, form: str) -> str:
    return f"{np.median(values):{form}} [{values.min():{form}}, {values.max():{form}}]"


def run(out: Path | None, seeds: int) -> None:
    """Measure, print the results, and write them to a file.

    Args:
        out: JSON file; a Markdown page is written beside it. None writes nothing.
        seeds: Number of training seeds.
    """
    times = measure(seeds)
    rate = speed.measure_training(rounds=3)["PPO on QuadPendulum-v0 in wind"]
    text = markdown(times, rate)
    print(text)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        data = {"steps_per_second": rate, "reached": times}
        out.write_text(json.dumps(to_json_data(data), indent=1) + "\n", encoding="utf-8")
        out.with_suffix(".md").write_text(text, encoding="utf-8")


def main() -> None:
    """Read the command line and run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.time_to_beat", description="Measure training time.")
    parser.add_argument("--out", type=Path, help="JSON file for the results, with a Markdown page beside it")
    parser.add_argument("--seeds", type=int, default=5, help="number of training seeds, counted from 0 (default: 5)")
    arguments = parser.parse_args()
    if arguments.seeds < 1:
        parser.error(f"argument --seeds must be at least 1, not {arguments.seeds}")
    run(arguments.out, arguments.seeds)


if __name__ == "__main__":
    main()
