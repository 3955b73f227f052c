"""Train PPO with RLlib, and write the policy to a file that `quadpend evaluate` takes.

pip install "ray[rllib]"
python docs/examples/ppo_with_rllib.py --iterations 300
quadpend evaluate flatness rllib=runs/rllib/policy.npz --scenarios calm windy
"""

import argparse
from pathlib import Path

import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module import RLModule
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

from quadpend_baselines import Policy
from quadpend_train.policies.from_sb3 import read_layers
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy


def policy_from_checkpoint(checkpoint: Path) -> Policy:
    """Return the policy in a checkpoint of PPO. The first four outputs of its network are the mean of the action."""
    module = RLModule.from_checkpoint(str(checkpoint / "learner_group/learner/rl_module/default_policy"))
    *hidden, last = *module.encoder.actor_encoder.net.mlp, *module.pi.net.mlp
    head = torch.nn.Linear(last.in_features, 4)
    head.load_state_dict({"weight": last.weight[:4], "bias": last.bias[:4]})
    layers, fields = read_layers([*hidden, head])
    return MlpPolicy(layers, {"format": FORMAT, **fields, "hybrid": None, "interface": "wrench"})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Train PPO with RLlib.")
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--num-envs", type=int, default=64, help="sub-environments of each process")
    parser.add_argument("--num-env-runners", type=int, default=0, help="processes that collect steps; 0: this one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/rllib"))
    args = parser.parse_args()
    algorithm = (
        PPOConfig()
        .environment("quadpend_gym:QuadPendulum-v0", env_config={"wind": "windy"})
        .env_runners(
            num_env_runners=args.num_env_runners,
            num_envs_per_env_runner=args.num_envs,
            gym_env_vectorize_mode="vector_entry_point",
        )
        .rl_module(
            model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False)
        )
        .training(train_batch_size_per_learner=8192, minibatch_size=1024, num_epochs=4, lr=1e-3, gamma=0.995)
        .debugging(seed=args.seed)
        .build_algo()
    )
    for iteration in range(args.iterations):
        result = algorithm.train()["env_runners"]
        print(f"{iteration}: episodes of {result.get('episode_len_mean', float('nan')):.0f} steps", flush=True)
    policy_from_checkpoint(Path(algorithm.save_to_path(args.out.absolute() / "checkpoint"))).save(
        args.out / "policy.npz"
    )
    algorithm.stop()
