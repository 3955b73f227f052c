"""Train PPO with rsl-rl, all arrays on the GPU.

    pip install 'quadpend-gym[gpu,rsl]'
    python docs/examples/ppo_on_gpu.py --num-envs 4096 --iterations 300

The observations, rewards and actions never leave the device. `NUMBA_ENABLE_CUDASIM=1` runs the script without a GPU, in
numba's simulator, which is slow: use it with ``--num-envs 4 --iterations 1``.
"""

import argparse
import os
from typing import Any

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from quadpend_gym.gpu import DeviceVectorEnv

DEVICE = "cpu" if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1" else "cuda"


class RslRlEnv(VecEnv):
    """A `DeviceVectorEnv` with the interface of rsl-rl."""

    def __init__(self, num_envs: int, seed: int) -> None:
        """Start the first episodes."""
        self.env = DeviceVectorEnv(num_envs, from_dlpack=torch.from_dlpack)
        self.num_envs, self.num_actions, self.device, self.cfg = num_envs, 4, DEVICE, {}
        self.max_episode_length = self.env.max_episode_steps
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.long, device=DEVICE)
        self._observation, _ = self.env.reset(seed=seed)

    def get_observations(self) -> TensorDict:
        """Return the observations of the last step."""
        return TensorDict({"policy": self._observation}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Apply the actions, clipped to [−1, 1]."""
        actions = actions.clamp(-1.0, 1.0).contiguous()
        self._observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = info["_final_obs"]
        self.episode_length_buf = torch.where(ended, 0, self.episode_length_buf + 1)
        return self.get_observations(), reward.float(), ended.long(), {"time_outs": truncated & ~terminated}


def settings(steps: int) -> dict[str, Any]:
    """Return the settings of rsl-rl for rollouts of `steps` steps."""
    network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "relu"}
    return {
        "algorithm": {"class_name": "PPO", "gamma": 0.995, "entropy_coef": 0.0, "learning_rate": 1e-3},
        "actor": {**network, "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.5}},
        "critic": network,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "num_steps_per_env": steps,
        "save_interval": 50,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Train PPO on a GPU.")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--steps", type=int, default=32, help="steps of each sub-environment in an iteration")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="runs/ppo-on-gpu", help="folder of the checkpoints")
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    env = RslRlEnv(args.num_envs, args.seed)
    OnPolicyRunner(env, settings(args.steps), args.out, DEVICE).learn(args.iterations)
    env.env.check_actions()
