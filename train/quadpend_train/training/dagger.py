"""Imitation of a base controller with DAgger (dataset aggregation), before training.

In every round the policy acts in the environment, the base controller labels each observation with the action that it
would apply, and the network is fitted to all labels so far. The training data therefore contain the states that the
policy itself reaches. In the first round the base controller acts. The loss of a batch of n labels a* is

    (1)  mean_i sqrt(|π(o_i) − a*_i|² + ε²),

the mean length of the error and not its square, so that the few large errors at the beginning of an episode do not
outweigh the many small ones near the reference, on which the settled tracking error depends.

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
_PASSES = 0.4, 4.0  # gradient steps in a round and in the last round, as passes over the labels of all rounds
_BATCH_SIZE = 1024
_LEARNING_RATES = 5e-3, 1e-5  # of Adam at the beginning and at the end, geometric interpolation in between
_NOISE = 0.1  # largest standard deviation of the noise on the actions, which leads to states that need a correction
_EPSILON = 1e-3  # ε of equation (1)


def dagger(model: Any, env: SB3VecEnv, settings: TrainSettings) -> float:
    """Fit the model's policy to the actions of its base controller.

    Args:
        model: An untrained model of PPO, SAC, TQC or APG.
        env: Training environment with a `VectorHybridWrapper` whose hybrid is `EstimateOnly`.
        settings: Settings of the run.

    Returns:
        The root mean square of the difference between the policy's and the base controller's actions.
    """
    random = np.random.default_rng(settings.seed)
    optimizer = torch.optim.Adam(_actor_parameters(model), lr=_LEARNING_RATES[0])
    steps = max(settings.hybrid.imitation_timesteps // (_ROUNDS * env.num_envs), 1)
    rows = steps * env.num_envs  # labels of a round
    size = env.observation_space.shape[0]  # type: ignore[index]
    observations, actions = np.empty((_ROUNDS * rows, size), np.float32), np.empty((_ROUNDS * rows, 4), np.float32)
    passes = [_PASSES[0]] * (_ROUNDS - 1) + [_PASSES[1]]
    observation = env.reset()
    for number in range(_ROUNDS):
        labels = slice(number * rows, (number + 1) * rows)
        observation = _act(model, env, observation, observations[labels], actions[labels], number == 0, random)
        done, now = (sum(passes[: number + i]) / sum(passes) for i in range(2))
        rates = [_LEARNING_RATES[0] ** (1.0 - part) * _LEARNING_RATES[1] ** part for part in (done, now)]
        batches = max(round(passes[number] * len(actions) / _BATCH_SIZE), 1)
        _fit(
            model,
            optimizer,
            observations[: labels.stop],
            actions[: labels.stop],
            np.geomspace(rates[0], rates[1], batches),
            random,
        )
    with torch.no_grad():
        error = _mean_action(model, torch.as_tensor(observations[labels])) - torch.as_tensor(actions[labels])
    return float(error.pow(2).mean().sqrt())


def _act(
    model: Any, env: SB3VecEnv, observation: Any, observations: Any, actions: Any, teacher: bool, random: Any
) -> Any:
    """Fill the arrays with the observations of a round and their labels, and return the next observation.

    The standard deviation of the noise differs between the sub-environments, from 0 to `_NOISE`.
    """
    wrapper = _hybrid_wrapper(env.env)
    noise = _NOISE * random.permutation(np.linspace(0.0, 1.0, env.num_envs))[:, np.newaxis] ** 2
    for start in range(0, len(actions), env.num_envs):
        label = wrapper.base_action
        observations[start : start + env.num_envs], actions[start : start + env.num_envs] = observation, label
        action = label if teacher else model.predict(observation, deterministic=True)[0]
        noisy = action + noise * random.normal(size=action.shape)
        observation = env.step(np.clip(noisy, -1.0, 1.0).astype(np.float32))[0]
    return observation


def _fit(model: Any, optimizer: Any, observations: Any, actions: Any, learning_rates: Any, random: Any) -> None:
    """Fit the actor to labelled observations with one gradient step, on a random batch, for each learning rate."""
    inputs, labels = torch.as_tensor(observations), torch.as_tensor(actions)
    for rate in learning_rates:
        batch = torch.as_tensor(random.integers(len(inputs), size=min(_BATCH_SIZE, len(inputs))))
        error = _mean_action(model, inputs[batch]) - labels[batch]
        loss = (error.pow(2).sum(dim=1) + _EPSILON**2).sqrt().mean()
        optimizer.param_groups[0]["lr"] = float(rate)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()


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
