"""Imitation of a base controller with DAgger (dataset aggregation), before training.

In every round the policy acts in the environment, the base controller labels each observation with the action that it
would apply, and the network is fitted to all labels so far. The training data therefore contain the states that the
policy itself reaches. In the first round the base controller acts. It flies for at least the length of an episode, and
each row begins its second episode at another time, so that from then on the labels of a step are spread over all times
of an episode. The loss of a batch of n labels a* is

    (1)  mean_i sqrt(|π(o_i) − a*_i|² + ε²),

the mean length of the error and not its square, so that the few large errors at the beginning of an episode do not
outweigh the many small ones near the reference, on which the settled tracking error depends.

Source: Ross, Gordon and Bagnell, A reduction of imitation learning and structured prediction to no-regret online
learning, AISTATS 2011.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_train.envs.concatenated import worlds
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.training.environment import hybrid_wrappers
from quadpend_train.training.settings import TrainSettings

_ROUNDS = 10
_PASSES = 0.4, 4.0  # gradient steps in a round and in the last round, as passes over the labels of all rounds
_BATCH_SIZE = 1024
_LEARNING_RATES = 5e-3, 1e-5  # of Adam at the beginning and at the end, geometric interpolation in between
_NOISE = 0.1  # largest standard deviation of the noise on the actions, which leads to states that need a correction
_EPSILON = 1e-3  # ε of equation (1)


def dagger(model: Any, env: SB3VecEnv, settings: TrainSettings, check_time: Callable[[], None]) -> float:
    """Fit the model's policy to the actions of its base controller.

    Args:
        model: An untrained model of PPO, SAC, TQC or APG.
        env: Training environment of `settings`, whose hybrid is `EstimateOnly`.
        settings: Settings of the run.
        check_time: Called before each step and each gradient step; it may raise an exception to stop the imitation.

    Returns:
        The root mean square of the difference between the policy's and the base controller's actions, over all rows and
        components, in a flight of the fitted policy without noise, on whose labels it was not fitted.
    """
    random = np.random.default_rng(settings.seed)
    optimizer = torch.optim.Adam(_actor_parameters(model), lr=_LEARNING_RATES[0])
    steps = max(settings.hybrid.imitation_timesteps // (_ROUNDS * env.num_envs), 1)
    rows = steps * env.num_envs  # labels of a round
    episode = settings.max_episode_steps or max(scenario.steps for scenario in settings.found(0).values())
    size = env.observation_space.shape[0]  # type: ignore[index]
    observations, actions = np.empty((_ROUNDS * rows, size), np.float32), np.empty((_ROUNDS * rows, 4), np.float32)
    passes = [_PASSES[0]] * (_ROUNDS - 1) + [_PASSES[1]]
    for number in range(_ROUNDS):
        labels = slice(number * rows, (number + 1) * rows)
        if number == 0:
            observation = _fly_teacher(env, observations[labels], actions[labels], episode, random, check_time)
        else:
            noise = _noise(env.num_envs, random)
            observation = _fly_policy(
                model, env, observation, observations[labels], actions[labels], noise, random, check_time
            )
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
            check_time,
        )
    _fly_policy(
        model, env, observation, observations[labels], actions[labels], np.zeros((env.num_envs, 1)), random, check_time
    )
    with torch.no_grad():
        error = _mean_action(model, torch.as_tensor(observations[labels])) - torch.as_tensor(actions[labels])
    return float(error.pow(2).mean().sqrt())


def _noise(rows: int, random: Any) -> Any:
    """Return the standard deviation of the noise of each row, from 0 to `_NOISE`, shape (n, 1)."""
    return _NOISE * random.permutation(np.linspace(0.0, 1.0, rows))[:, np.newaxis] ** 2


def _fly_teacher(
    env: SB3VecEnv, observations: Any, actions: Any, episode: int, random: Any, check_time: Callable[[], None]
) -> Any:
    """Fill the arrays with labels of a flight of the base controller, and return the next observation.

    Args:
        env: Training environment.
        observations: Array for the observations, shape (k · n, m) for n rows.
        actions: Array for the labels, shape (k · n, 4).
        episode: Control steps of an episode. The flight has at least as many; labels are kept from k of its steps.
        random: Random generator.
        check_time: As for `dagger`.
    """
    rows, wrappers, noise = env.num_envs, hybrid_wrappers(env.env), _noise(env.num_envs, random)
    flown = max(episode, len(actions) // rows)
    kept = np.sort(random.choice(flown, len(actions) // rows, replace=False))
    count = len(worlds(env.env))
    share = rows // count
    begins = np.tile(random.permutation(share) * episode // share, count)  # step of a row's second episode
    observation, start = env.reset(), 0
    for step in range(flown):
        if step and (begun := begins == step).any():
            observation = env.restart(begun)
        label = _base_action(wrappers)
        if start < len(actions) and step == kept[start // rows]:
            observations[start : start + rows], actions[start : start + rows] = observation, label
            start += rows
        check_time()
        observation = _step(env, label, noise, random)
    return observation


def _fly_policy(
    model: Any,
    env: SB3VecEnv,
    observation: Any,
    observations: Any,
    actions: Any,
    noise: Any,
    random: Any,
    check_time: Callable[[], None],
) -> Any:
    """Fill the arrays with observations of a flight of the policy and their labels, and return the next observation."""
    rows, wrappers = env.num_envs, hybrid_wrappers(env.env)
    for start in range(0, len(actions), rows):
        observations[start : start + rows], actions[start : start + rows] = observation, _base_action(wrappers)
        check_time()
        observation = _step(env, model.predict(observation, deterministic=True)[0], noise, random)
    return observation


def _step(env: SB3VecEnv, action: Any, noise: Any, random: Any) -> Any:
    """Take a step with noise of the standard deviation `noise` on the actions, and return the next observation."""
    noisy = action + noise * random.normal(size=action.shape)
    return env.step(np.clip(noisy, -1.0, 1.0).astype(np.float32))[0]


def _fit(
    model: Any,
    optimizer: Any,
    observations: Any,
    actions: Any,
    learning_rates: Any,
    random: Any,
    check_time: Callable[[], None],
) -> None:
    """Fit the actor to labelled observations with one gradient step, on a random batch, for each learning rate."""
    inputs, labels = torch.as_tensor(observations), torch.as_tensor(actions)
    for rate in learning_rates:
        check_time()
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
    return model.actor._predict(observation, deterministic=True)


def _actor_parameters(model: Any) -> list[Any]:
    if not hasattr(model.policy, "action_net"):
        return list(model.actor.parameters())
    return [*model.policy.mlp_extractor.policy_net.parameters(), *model.policy.action_net.parameters()]


def _base_action(wrappers: Sequence[VectorHybridWrapper]) -> Any:
    return np.concatenate([wrapper.base_action for wrapper in wrappers])
