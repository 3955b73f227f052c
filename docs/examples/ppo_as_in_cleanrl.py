"""PPO in one file, in the manner of CleanRL's ``ppo_continuous_action.py``.

With same-step autoreset, `obs` is the first observation of the next episode when an episode is done. As in CleanRL's
script, the loop does not bootstrap the value at the time limit.

    python docs/examples/ppo_as_in_cleanrl.py
"""

import argparse

import gymnasium as gym
import torch
from torch import nn
from torch.distributions import Normal

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--updates", type=int, default=200, help="200 updates are 3.3 million steps")
num_envs, num_steps, updates = 256, 64, parser.parse_args().updates
envs = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=num_envs, wind="windy", autoreset_mode="SameStep")
torch.set_num_threads(1)
actor = nn.Sequential(nn.Linear(36, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 4))
critic = nn.Sequential(nn.Linear(36, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
log_std = nn.Parameter(torch.full((4,), -0.5))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=1e-3)


def evaluate(obs, action):
    normal = Normal(actor(obs), log_std.exp())
    return normal.log_prob(action).sum(-1), critic(obs).squeeze(-1)


obs = torch.as_tensor(envs.reset(seed=0)[0])
for update in range(updates):
    batch_obs, batch_action, batch_reward, batch_done = [], [], [], []
    for _ in range(num_steps):
        with torch.no_grad():
            action = Normal(actor(obs), log_std.exp()).sample()
        batch_obs.append(obs)
        batch_action.append(action)
        new_obs, reward, terminated, truncated, info = envs.step(action.clamp(-1.0, 1.0).numpy())
        batch_reward.append(torch.as_tensor(0.01 * reward, dtype=torch.float32))
        batch_done.append(torch.as_tensor(terminated | truncated, dtype=torch.float32))
        obs = torch.as_tensor(new_obs.copy())
    observations, actions = torch.stack(batch_obs), torch.stack(batch_action)
    with torch.no_grad():
        old_log_prob, values = evaluate(observations, actions)
        next_value, advantage = critic(obs).squeeze(-1), torch.zeros(num_envs)
        advantages = torch.zeros_like(values)
        for t in reversed(range(num_steps)):
            going_on = 1.0 - batch_done[t]
            delta = batch_reward[t] + 0.995 * next_value * going_on - values[t]
            advantage = delta + 0.995 * 0.95 * going_on * advantage
            advantages[t], next_value = advantage, values[t]
        returns = advantages + values
    flat = [x.flatten(0, 1) for x in (observations, actions, old_log_prob, advantages, returns)]
    for _ in range(3):
        for rows in torch.randperm(num_envs * num_steps).split(2048):
            o, a, old, adv, ret = (x[rows] for x in flat)
            log_prob, value = evaluate(o, a)
            ratio, adv = (log_prob - old).exp(), (adv - adv.mean()) / (adv.std() + 1e-8)
            policy_loss = -torch.min(ratio * adv, ratio.clamp(0.8, 1.2) * adv).mean()
            loss = policy_loss + 0.5 * (value - ret).pow(2).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()
    if update % 20 == 0:
        ended = int(torch.stack(batch_done).sum())
        print(f"update {update}: mean length of an episode {num_envs * num_steps / max(ended, 1):.0f} steps")
