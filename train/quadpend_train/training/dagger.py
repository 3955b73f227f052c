"""Imitation of a base controller with DAgger (dataset aggregation), before training.

In every round the policy acts in the environment, the base controller labels each observation with the action that it
would apply, and the network is fitted to all labels so far. The training data therefore contain the states that the
policy itself reaches. In the first round the base controller acts.

Source: Ross, Gordon and Bagnell, A reduction of imitation learning and structured prediction to no-regret online
learning, AISTATS 2011.
"""

from typing import Any

import numpy as np
import torch

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.training.settings import TrainSettings

_ROUNDS = 10
_EPOCHS = 4  # over all labels, after every round except the last
_LAST_EPOCHS = 20  # after the last round
_BATCH_SIZE = 2048
_LEARNING_RATES = 2e-3, 1e-4  # of Adam in the first and in the last round, geometric interpolation in between
_NOISE = 0.05  # standard deviation of the noise on the actions, which leads to states that need a correction


def dagger(model: Any, env: SB3VecEnv, settings: TrainSettings) -> float:
    """Fit the model's policy to the actions of its base controller.

    Args:
        model: An untrained model of PPO, SAC or TQC.
        env: Training environment with a `VectorHybridWrapper` whose hybrid is `EstimateOnly`.
        settings: Settings of the run.

    Returns:
        The root mean square of the difference between the policy's and the base controller's actions.
    """
    wrapper = _hybrid_wrapper(env.env)
    random = np.random.default_rng(settings.seed)
    optimizer = torch.optim.Adam(_actor_parameters(model), lr=_LEARNING_RATES[0])
    observations, actions = [], []
    observation = env.reset()
    for number in range(_ROUNDS):
        for _ in range(max(settings.hybrid.imitation_timesteps // (_ROUNDS * env.num_envs), 1)):
            label = wrapper.base_action
            observations.append(observation)
            actions.append(label)
            action = label if number == 0 else model.predict(observation, deterministic=True)[0]
            noisy = action + _NOISE * random.normal(size=action.shape)
            observation = env.step(np.clip(noisy, -1.0, 1.0).astype(np.float32))[0]
        progress = number / (_ROUNDS - 1)
        optimizer.param_groups[0]["lr"] = _LEARNING_RATES[0] ** (1.0 - progress) * _LEARNING_RATES[1] ** progress
        epochs = _LAST_EPOCHS if number == _ROUNDS - 1 else _EPOCHS
        loss = _fit(model, optimizer, np.concatenate(observations), np.concatenate(actions), epochs, random)
    return float(np.sqrt(loss))


def _fit(model: Any, optimizer: Any, observations: Any, actions: Any, epochs: int, random: Any) -> float:
    """Fit the actor to labelled observations and return the mean squared error of the last epoch."""
    inputs, labels = torch.as_tensor(observations), torch.as_tensor(actions)
    losses: list[float] = []
    for _ in range(epochs):
        order = torch.as_tensor(random.permutation(len(inputs)))
        losses = []
        for batch in torch.split(order, _BATCH_SIZE):
            loss = torch.nn.functional.mse_loss(_mean_action(model, inputs[batch]), labels[batch])
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()
            losses.append(loss.item())
    return float(np.mean(losses))


def _mean_action(model: Any, observation: Any) -> Any:
    """Return the deterministic action as a differentiable tensor."""
    if hasattr(model.policy, "action_net"):
        return model.policy.get_distribution(observation).distribution.mean
    return model.actor(observation, deterministic=True)


def _actor_parameters(model: Any) -> list[Any]:
    if not hasattr(model.policy, "action_net"):
        return list(model.actor.parameters())
    return [*model.policy.mlp_extractor.policy_net.parameters(), *model.policy.action_net.parameters()]


def _hybrid_wrapper(env: Any) -> VectorHybridWrapper:
    """Return the hybrid's wrapper among the wrappers of the training environment."""
    while not isinstance(env, VectorHybridWrapper):
        env = env.env
    return env
