"""Train SAC to balance the pendulum in wind, with plain Stable-Baselines3.

    python train/sac.py                             # two to four minutes on one core
    python train/sac.py --total-timesteps 400_000   # a better policy, at least ten minutes

A step of SAC takes much longer than a step of PPO. The default ends with a mean return of about 130 of 1000; an
untrained policy has about 30. In the same time `ppo.py` reaches about 700.

Writes `sac.zip`. `quadpend evaluate sac.zip flatness --scenarios windy` compares it with a classical controller.
"""

import argparse

import gymnasium as gym
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.evaluation import evaluate_policy

from quadpend_train.envs.sb3_vec_env import SB3VecEnv

parser = argparse.ArgumentParser(description="Train SAC in wind.")
parser.add_argument("--total-timesteps", type=int, default=80_000, help="environment steps of training")
parser.add_argument("--wind", default="windy", help="calm, breeze, windy, storm or paper")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="sac.zip", help="file of the trained model")
args = parser.parse_args()

torch.set_num_threads(1)  # more threads slow down networks as small as this one
envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=16, wind=args.wind, autoreset_mode="SameStep")
model = SAC(
    "MlpPolicy",
    SB3VecEnv(envs),
    train_freq=1,  # a step of all 16 sub-environments
    gradient_steps=4,
    batch_size=256,
    buffer_size=300_000,
    learning_starts=5_000,
    learning_rate=1e-3,
    gamma=0.98,
    tau=0.02,
    ent_coef="auto_0.05",
    policy_kwargs={"net_arch": [64, 64]},
    seed=args.seed,
    device="cpu",
    verbose=1,
)
model.learn(args.total_timesteps, log_interval=50)
model.save(args.out)

envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=20, wind=args.wind, autoreset_mode="SameStep")
test_envs = SB3VecEnv(envs)
test_envs.seed(3_000_000)  # episodes that no training run uses
mean, deviation = evaluate_policy(model, test_envs, n_eval_episodes=20)
print(f"Mean return of 20 episodes: {mean:.0f} ± {deviation:.0f}; the maximum is 1000. Saved: {args.out}")
