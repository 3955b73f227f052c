"""Train PPO to balance the pendulum in wind, with plain Stable-Baselines3.

    python train/ppo.py                               # about a minute on two cores
    python train/ppo.py --total-timesteps 7_000_000   # a better policy, in proportionally more time
    python train/ppo.py --wind calm                   # 1_500_000 steps are enough without wind

A progress bar shows the time that is left. The return of an untrained policy is about 30 of 1000; the default ends with
about 700. The tuned classical controller `flatness` is printed beside it: it is better, see docs/results.md.

Writes `ppo.zip`. `quadpend evaluate ppo.zip flatness --scenarios windy` compares it with a classical controller.
"""

import argparse

import gymnasium as gym
import torch
from stable_baselines3 import PPO

from quadpend_baselines import controller
from quadpend_train import SB3VecEnv, Scenario, run_episodes

parser = argparse.ArgumentParser(description="Train PPO in wind.")
parser.add_argument("--total-timesteps", type=int, default=3_000_000, help="environment steps of training")
parser.add_argument("--wind", default="windy", help="calm, breeze, windy, storm or paper")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="ppo.zip", help="file of the trained model")
args = parser.parse_args()

torch.set_num_threads(1)  # more threads slow down networks as small as this one
envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=256, wind=args.wind, autoreset_mode="SameStep")
model = PPO(
    "MlpPolicy",
    SB3VecEnv(envs, reward_scale=0.01),  # discounted returns of order 1
    n_steps=64,
    batch_size=1024,
    n_epochs=3,
    learning_rate=lambda remaining: 2e-3 * remaining,
    gamma=0.995,
    policy_kwargs={"net_arch": [64, 64], "activation_fn": torch.nn.ReLU},
    seed=args.seed,
    device="cpu",
)
model.learn(args.total_timesteps, progress_bar=True)
model.save(args.out)

print(f"Saved: {args.out}. Mean of 20 episodes that the training has not used, in wind {args.wind!r}:")
for name, policy in {"PPO": model, "flatness": controller("flatness"), "adrc-paper": controller("adrc-paper")}.items():
    result = run_episodes([policy], Scenario(wind=args.wind), episodes=20)
    rmse = 1e3 * result.penalised_rmse.mean()  # a fall counts as 1 m
    print(
        f"{name:10} survival {result.survived.mean():4.0%}  penalised RMSE {rmse:4.0f} mm"
        f"  mean return {result.episode_return.mean():4.0f} of 1000"
    )
