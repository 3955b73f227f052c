"""How long a learner trains until it beats whom: wall-clock and steps, over several seeds.

A run is looked at again and again while it trains: its policy, without exploration, flies episodes that nobody trains
in. The clock stands still meanwhile. A goal is reached when

- balanced: 95 % of the episodes in wind are survived;
- paper: penalised RMSE in wind, which counts a fall as 1 m, is better than the paper's ADRC's in the same episodes;
- classical: penalised RMSE is better than the best classical controller's, over the training scenarios together, by a
  paired 95 % interval that excludes zero, at a survival that is not lower.

Since a run is looked at many times, a goal counts only if the same policy reaches it in a second block of episodes too.
The first two are measured in one training of PPO that acts alone, beside the flatness-based controller's observer and
after imitating that controller (settings ``fast``); the third with the hybrid, which begins as the controller that it
has to beat. Making the environment and imitation are in the seconds, imports and compilation are not. Steps are control
steps of the learner, those of an imitation among them, those of a twin not.
"""

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
from quadpend_train.common.files import plain
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.statistics import mean
from quadpend_train.policies.export import export
from quadpend_train.scenarios import SETS
from quadpend_train.training.settings import TrainSettings, read_settings
from quadpend_train.training.train import train

EPISODES = 100
SEEDS = (VALIDATION_SEED, VALIDATION_SEED + 10_000)
Judge = Callable[[Policy], bool]


class Goal(NamedTuple):
    """What is to be reached."""

    settings: str  # of the training, see `quadpend_train.training.settings`
    every: int  # steps between two looks
    target: float  # s
    judge: Callable[[int], Judge]  # in the episodes from a seed on


class Reached(NamedTuple):
    """When a run has reached a goal; infinite where it has not."""

    seconds: float
    steps: float


def _balanced(seed: int) -> Judge:
    return lambda policy: bool(run_episodes([policy], "windy", EPISODES, seed).survived.mean() >= 0.95)


def _better_than_paper(seed: int) -> Judge:
    paper = run_episodes([controller("adrc-paper")], "windy", EPISODES, seed)

    def judge(policy: Policy) -> bool:
        return bool(run_episodes([policy], "windy", EPISODES, seed).penalised_rmse.mean() < paper.penalised_rmse.mean())

    return judge


def _better_than_classical(seed: int) -> Judge:
    best = [run_episodes([controller("flatness")], name, EPISODES, seed) for name in SETS["training"]]

    def judge(policy: Policy) -> bool:
        flown = [run_episodes([policy], name, EPISODES, seed) for name in SETS["training"]]
        difference = sum(mine.penalised_rmse - its.penalised_rmse for mine, its in zip(flown, best, strict=True))
        survived = sum(mine.survived.mean() - its.survived.mean() for mine, its in zip(flown, best, strict=True))
        return bool(mean(np.asarray(difference)).high < 0.0 and survived >= 0.0)

    return judge


GOALS = {
    "balanced": Goal("fast", 100_000, 20.0, _balanced),
    "paper": Goal("fast", 250_000, 45.0, _better_than_paper),
    "classical": Goal("ppo-pace", 100_000, 1200.0, _better_than_classical),
}


class _Look(BaseCallback):
    """Asks now and then which goals are reached, with the clock stopped; ends the run when all are."""

    def __init__(self, settings: TrainSettings, judges: dict[str, tuple[int, list[Judge]]]) -> None:
        super().__init__()
        self.settings, self.judges = settings, judges
        self.reached: dict[str, Reached] = {}
        self.paused, self.began = 0.0, time.perf_counter()
        # What has learned nothing yet is not looked at.
        self.next = {name: 0 if settings.imitation_steps else every for name, (every, _) in judges.items()}

    def _on_rollout_start(self) -> None:
        for name, (every, blocks) in self.judges.items():
            if name in self.reached or self.num_timesteps < self.next[name]:
                continue
            self.next[name] = self.num_timesteps + every
            now = time.perf_counter()
            policy = export(self.model, self.settings.view())
            if all(judge(policy) for judge in blocks):
                steps = float(self.num_timesteps * self.settings.hold + self.settings.imitation_steps)
                self.reached[name] = Reached(now - self.began - self.paused, steps)
            self.paused += time.perf_counter() - now

    def _on_step(self) -> bool:
        return len(self.reached) < len(self.judges)


def measure(seeds: int = 5, names: tuple[str, ...] = tuple(GOALS)) -> dict[str, list[Reached]]:
    """When each of the goals is reached, for each training seed."""
    goals = {name: GOALS[name] for name in names}
    judges = {name: [goal.judge(seed) for seed in SEEDS] for name, goal in goals.items()}
    found: dict[str, list[Reached]] = {name: [] for name in names}
    for settings in dict.fromkeys(goal.settings for goal in goals.values()):
        asked = {name: (goal.every, judges[name]) for name, goal in goals.items() if goal.settings == settings}
        for seed in range(seeds):
            run = replace(read_settings(settings), seed=seed, eval_freq=0, patience=0)
            look = _Look(run, asked)
            with tempfile.TemporaryDirectory() as folder:
                train(run, Path(folder) / "run", progress=False, more=[look])
            for name in asked:
                found[name].append(look.reached.get(name, Reached(np.inf, np.inf)))
                print(f"{name}, seed {seed}: {found[name][-1].seconds:.1f} s", flush=True)
    return found


def markdown(found: dict[str, list[Reached]], rate: float) -> str:
    """Medians and ranges as a Markdown table."""
    lines = [
        "# Time to beat",
        "",
        f"Of {max(map(len, found.values()))} training seeds, each confirmed in a second block of {EPISODES} episodes;"
        " `make time-to-beat` measures yours.",
        "What the goals are is in [`time_to_beat.py`](../benchmarks/time_to_beat.py).",
        f"{platform.machine()}, one process; PPO makes {rate / 1e3:.0f} k steps/s on it in the demo's training.",
        "",
        "| goal | training | seconds, median [range] | steps, median [range] | target |",
        "|---|---|---|---|---|",
    ]
    for name, runs in found.items():
        seconds, steps = (np.array(values) for values in zip(*runs, strict=True))
        goal = GOALS[name]
        lines.append(
            f"| {name} | `{goal.settings}` | {_spread(seconds, '.1f')} | {_spread(steps / 1e6, '.2f')} M"
            f" | ≤ {goal.target:.0f} s |"
        )
    return "\n".join(lines) + "\n"


def _spread(values: Any, form: str) -> str:
    return f"{np.median(values):{form}} [{values.min():{form}}, {values.max():{form}}]"


def main(out: Path | None, seeds: int) -> None:
    """Measure, print, and write the figures to `out`, and as a table beside it."""
    found = measure(seeds)
    rate = speed.measure_training(turns=3)["PPO on QuadPendulum-v0 in wind"]
    text = markdown(found, rate)
    print(text)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        data = {"steps_per_second": rate, "reached": found}
        out.write_text(json.dumps(plain(data), indent=1) + "\n", encoding="utf-8")
        out.with_suffix(".md").write_text(text, encoding="utf-8")
