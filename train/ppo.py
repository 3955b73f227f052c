"""Train PPO to balance the pendulum in wind, with plain Stable-Baselines3.

    python train/ppo.py                               # one to two minutes on one core
    python train/ppo.py --total-timesteps 7_000_000   # a better policy, in proportionally more time

The default ends with a mean return of about 700 of 1000; the return of an untrained policy is about 30.

Writes `ppo.zip`. `python train/compare.py ppo.zip` compares it with two classical controllers.
"""

import argparse

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from quadpend_train.envs.sb3_vec_env import SB3VecEnv

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
    verbose=1,
)
model.learn(args.total_timesteps, log_interval=20)
model.save(args.out)

envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=20, wind=args.wind, autoreset_mode="SameStep")
test_envs = SB3VecEnv(envs)
test_envs.seed(3_000_000)  # episodes that no training run uses
mean, deviation = evaluate_policy(model, test_envs, n_eval_episodes=20)
print(f"Mean return of 20 episodes: {mean:.0f} ± {deviation:.0f}; the maximum is 1000. Saved: {args.out}")
