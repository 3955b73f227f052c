"""Compare a model that Stable-Baselines3 has saved with two classical controllers, in the same episodes.

    python train/compare.py ppo.zip     # about half a minute

Writes the policy beside the model (`ppo.npz`): a file that executes no code when it is loaded, and that the command
`quadpend evaluate` accepts. Loading the model itself executes code that is in it: compare only
models whose source you trust.
"""

import argparse
from pathlib import Path

from quadpend_baselines import controller
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.policies.export import export_zip

parser = argparse.ArgumentParser(description="Compare a saved model with two classical controllers.")
parser.add_argument("model", type=Path, help="file (.zip) saved by PPO, SAC or TQC")
parser.add_argument("--scenarios", nargs="+", default=["windy", "gusts"])
parser.add_argument("--episodes", type=int, default=100, help="episodes of each policy in each scenario")
args = parser.parse_args()

learned = export_zip(args.model)
learned.save(args.model.with_suffix(".npz"))
policies = {args.model.stem: learned, "flatness": controller("flatness"), "adrc-paper": controller("adrc-paper")}

print(f"{'scenario':<12} {'policy':<12} {'survival':>8} {'penalised RMSE':>15} {'return':>7}")
for scenario in args.scenarios:
    for name, policy in policies.items():
        results = run_episodes([policy], scenario, args.episodes)
        rmse = 1e3 * results.penalised_rmse.mean()  # a fall counts as 1 m
        print(
            f"{scenario:<12} {name:<12} {results.survived.mean():>8.0%} {rmse:>12.1f} mm"
            f" {results.episode_return.mean():>7.0f}"
        )
