"""docs/learning.md: plain Stable-Baselines3 on the measurements of `lab`, up to ten minutes on one core for each row.

    python -m experiments.plain_sb3 ppo-recipe      # trains, writes runs/plain/ppo-recipe.zip, and prints its row
    python -m experiments.plain_sb3 lqg             # the row of a policy that needs no training

The learners train in `flight_training_wind` with the seed 0, for about ten minutes of processor time.
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC

from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train import SB3VecEnv, run_episodes
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.statistics import mean, proportion
from quadpend_train.policies.loading import load_policies

SCENARIOS = "flight_training_wind", "flight_breeze"
TIMESTEPS = {"ppo": 29_687_808, "recurrent-ppo": 917_504, "sac": 150_000, "ppo-recipe": 20_000_000}
PERIODS = {"ppo-recipe": 0.04}  # s; that of the others is the one of the scenario, 0.01 s


def make(name: str) -> Any:
    """Return an untrained model."""
    common: dict[str, Any] = {"seed": 0, "device": "cpu"}
    ppo: dict[str, Any] = {"n_steps": 64, "batch_size": 1024, "n_epochs": 3, "gamma": 0.995}  # as in docs/training.md
    if name == "ppo":
        return PPO("MlpPolicy", _envs(256, 0.01, (4, 0)), **ppo, **common)
    if name == "recurrent-ppo":
        return RecurrentPPO("MlpLstmPolicy", _envs(256, 0.01), **ppo, **common)
    if name == "sac":  # as in docs/policies.md
        sac: dict[str, Any] = {"learning_starts": 10_000, "train_freq": 1, "gradient_steps": 4}
        return SAC("MlpPolicy", _envs(16, 1.0, (4, 0)), **sac, **common)
    recipe: dict[str, Any] = {"n_steps": 32, "batch_size": 2048, "n_epochs": 4, "gamma": 0.98, "gae_lambda": 0.98}
    recipe |= {"learning_rate": lambda remaining: 1e-3 * remaining, "policy_kwargs": {"log_std_init": -2.0}}
    return PPO("MlpPolicy", _envs(256, 0.04, (4, 3), period=PERIODS[name]), **recipe, **common)


def _envs(num_envs: int, reward_scale: float, stack: tuple[int, int] | None = None, **parts: Any) -> SB3VecEnv:
    scenario = as_scenario(SCENARIOS[0], **parts)
    envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs, scenario=scenario, autoreset_mode="SameStep")
    return SB3VecEnv(VectorHistoryWrapper(envs, *stack) if stack else envs, reward_scale)


def row(name: str, policy: str) -> list[str]:
    """Return the survival in 50 episodes of each scenario, and duration and error of the flights in the last one."""
    period, survival = PERIODS.get(name, 0.01), []
    for scenario in SCENARIOS:
        found = run_episodes(load_policies(policy), as_scenario(scenario, period=period), 50, VALIDATION_SEED)
        survival.append(format_interval(proportion(found.survived).scaled(100.0)))
    duration = mean(found.steps.astype(np.float64)).scaled(period)
    error = mean(np.where(found.survived, found.rmse, np.nan)).scaled(1e3)
    return [name, *survival, format_interval(duration), format_interval(error)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["lqg", *TIMESTEPS])
    given, rows = parser.parse_args(), []
    torch.set_num_threads(1)
    for name in given.names:
        file = Path(f"runs/plain/{name}.zip")
        if name in TIMESTEPS and not file.exists():
            make(name).learn(TIMESTEPS[name]).save(file)
        rows.append(row(name, str(file) if name in TIMESTEPS else name))
    print(
        markdown_table(["policy", *(f"survival, {name} (%)" for name in SCENARIOS), "flight (s)", "error (mm)"], rows)
    )
