"""docs/demo/, a minute of training: PPO with five training seeds, and two classical controllers.

    python -m experiments.demo      # ten minutes; runs/demo-0 to runs/demo-4 and docs/demo/

200 episodes in each scenario, seeds from 1000000.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from experiments.pages import CACHE, DOCS, options
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports.report import evaluate
from quadpend_train.training.settings import read_settings
from quadpend_train.training.train import train

TIMESTEPS, SEEDS = 1_200_000, range(5)


def main() -> None:
    """Train and evaluate."""
    given = options(__doc__, 200)
    settings = replace(read_settings("ppo-alone"), total_timesteps=TIMESTEPS)
    runs = {Path(f"runs/demo-{seed}"): replace(settings, seed=seed) for seed in SEEDS}
    seeds = [MlpPolicy.load(train(run, folder)) for folder, run in runs.items()]
    policies: dict[str, Any] = {"adrc-paper": "adrc-paper", "flatness": "flatness", "ppo": seeds}
    scenarios = ["calm", "windy", "steady", "gusts"]
    evaluate(policies, scenarios, DOCS / "demo", episodes=given.episodes, seed=given.seed, cache_folder=CACHE)


if __name__ == "__main__":
    main()
