"""A policy that begins as a copy of its companion: DAgger.

The learner flies, the companion says at every step what it would have done there, and the network is fitted to all that
was said so far. What it learns from is therefore where it gets itself to, not where the companion would have been.
"""

from typing import Any

import numpy as np
import torch

from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.training.settings import TrainSettings

_ROUNDS = 10  # of flying and fitting; in the first the companion flies
_PASSES = 4  # over all that was said, after each round but the last
_LAST_PASSES = 20
_BATCH = 2048
_RATES = 2e-3, 1e-4  # of Adam, falling from round to round
_NOISE = 0.05  # standard deviation of what is added to the actions, so that there is something to mend


def dagger(model: Any, env: SB3VecEnv, settings: TrainSettings) -> float:
    """Fit the model's policy to its companion's actions.

    Args:
        model: PPO, SAC or TQC, untrained.
        env: with a `VectorDisturbanceEstimateObservation` in it, whose controller is the teacher.
        settings: of the run.

    Returns:
        The root mean square of what is left between their actions.
    """
    teacher = _teacher(env.env)
    random = np.random.default_rng(settings.seed)
    optimizer = torch.optim.Adam(_parameters(model), lr=_RATES[0])
    observations, actions = [], []
    observation = env.reset()
    for number in range(_ROUNDS):
        for _ in range(max(settings.imitation_steps // (_ROUNDS * env.num_envs), 1)):
            wanted = teacher._memory.action
            observations.append(observation)
            actions.append(wanted)
            taken = wanted if number == 0 else model.predict(observation, deterministic=True)[0]
            noisy = taken + _NOISE * random.normal(size=taken.shape)
            observation = env.step(np.clip(noisy, -1.0, 1.0).astype(np.float32))[0]
        share = number / (_ROUNDS - 1)
        optimizer.param_groups[0]["lr"] = _RATES[0] ** (1.0 - share) * _RATES[1] ** share
        passes = _LAST_PASSES if number == _ROUNDS - 1 else _PASSES
        loss = _fit(model, optimizer, np.concatenate(observations), np.concatenate(actions), passes, random)
    return float(np.sqrt(loss))


def _fit(model: Any, optimizer: Any, observations: Any, actions: Any, passes: int, random: Any) -> float:
    seen, wanted = torch.as_tensor(observations), torch.as_tensor(actions)
    losses: list[float] = []
    for _ in range(passes):
        order = torch.as_tensor(random.permutation(len(seen)))
        losses = []
        for batch in torch.split(order, _BATCH):
            loss = torch.nn.functional.mse_loss(_mean(model, seen[batch]), wanted[batch])
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()
            losses.append(loss.item())
    return float(np.mean(losses))


def _mean(model: Any, observation: Any) -> Any:
    """The action without its noise, differentiable."""
    if hasattr(model.policy, "action_net"):
        return model.policy.get_distribution(observation).distribution.mean
    return model.actor(observation, deterministic=True)


def _parameters(model: Any) -> list[Any]:
    if not hasattr(model.policy, "action_net"):
        return list(model.actor.parameters())
    return [*model.policy.mlp_extractor.policy_net.parameters(), *model.policy.action_net.parameters()]


def _teacher(env: Any) -> Any:
    while not hasattr(env, "companion"):
        env = env.env
    return env
