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

from typing import Any

import numpy as np
import torch

from quadpend_train.envs.concatenated import worlds
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.sb3_models import linear_layers, mean_action
from quadpend_train.training.environment import hybrid_wrappers
from quadpend_train.training.settings import TrainSettings

_PASSES = 0.4, 4.0  # gradient steps in a round and in the last round, as passes over the labels of all rounds
_BATCH_SIZE = 1024
_LEARNING_RATES = 5e-3, 1e-5  # of Adam at the beginning and at the end, geometric interpolation in between
_NOISE = 0.1  # largest standard deviation of the noise on the actions, which leads to states that need a correction
_EPSILON = 1e-3  # ε of equation (1)


class Imitation:
    """The fit of an untrained model's policy to the actions of its base controller, in an `EstimateOnly` hybrid."""

    def __init__(self, model: Any, env: SB3VecEnv, settings: TrainSettings) -> None:
        self.model, self.env = model, env
        parameters = [item for layer in linear_layers(model) for item in layer.parameters()]
        self.random = np.random.default_rng(settings.seed)
        self.optimizer = torch.optim.Adam(parameters, lr=_LEARNING_RATES[0])
        self.episode = settings.max_episode_steps or max(item.steps for item in settings.scenarios)
        self.wrappers = hybrid_wrappers(env.env)
        self.rounds = rounds = settings.hybrid.imitation_rounds
        steps = max(settings.hybrid.imitation_timesteps // (rounds * env.num_envs), 1)
        self.labels = steps * env.num_envs  # of a round
        size = env.observation_space.shape[0]  # type: ignore[index]
        self.observations = np.empty((rounds * self.labels, size), np.float32)
        self.actions = np.empty((rounds * self.labels, 4), np.float32)
        self.observation: Any = None  # the next one

    def fit(self) -> None:
        """Fly and fit in all rounds."""
        passes = [_PASSES[0]] * (self.rounds - 1) + [_PASSES[1]]
        for number in range(self.rounds):
            first, last = number * self.labels, (number + 1) * self.labels
            if number == 0:
                self._fly_teacher()
            else:
                self._fly_policy(slice(first, last), self._noise())
            done, now = (sum(passes[: number + i]) / sum(passes) for i in range(2))
            rates = [_LEARNING_RATES[0] ** (1.0 - part) * _LEARNING_RATES[1] ** part for part in (done, now)]
            batches = max(round(passes[number] * len(self.actions) / _BATCH_SIZE), 1)
            self._fit(self.observations[:last], self.actions[:last], np.geomspace(rates[0], rates[1], batches))

    def _noise(self) -> Any:
        """Return the standard deviation of the noise of each row, from 0 to `_NOISE`, shape (n, 1)."""
        return _NOISE * self.random.permutation(np.linspace(0.0, 1.0, self.env.num_envs))[:, np.newaxis] ** 2

    def _fly_teacher(self) -> None:
        """Label a flight of the base controller of at least an episode, and keep the labels of some of its steps."""
        env, random, episode = self.env, self.random, self.episode
        rows, noise = env.num_envs, self._noise()
        flown = max(episode, self.labels // rows)
        kept = np.sort(random.choice(flown, self.labels // rows, replace=False))
        count = len(worlds(env.env))
        share = rows // count
        begins = np.tile(random.permutation(share) * episode // share, count)  # step of a row's second episode
        self.observation, start = env.reset(), 0
        for step in range(flown):
            if step and (begun := begins == step).any():
                self.observation = env.restart(begun)
            label = self._base_action()
            if start < self.labels and step == kept[start // rows]:
                self.observations[start : start + rows], self.actions[start : start + rows] = self.observation, label
                start += rows
            self._step(label, noise)

    def _fly_policy(self, labels: slice, noise: Any) -> None:
        """Label a flight of the policy with noise of these standard deviations on its actions."""
        rows = self.env.num_envs
        for start in range(labels.start, labels.stop, rows):
            part = slice(start, start + rows)
            self.observations[part], self.actions[part] = self.observation, self._base_action()
            self._step(self.model.predict(self.observation, deterministic=True)[0], noise)

    def _base_action(self) -> Any:
        """Return the labels: the actions of the base controllers as those of the policy."""
        found = [(wrapper.base_action - wrapper.built_on) / wrapper.hybrid.output for wrapper in self.wrappers]
        return np.concatenate(found)

    def _step(self, action: Any, noise: Any) -> None:
        noisy = action + noise * self.random.normal(size=action.shape)
        self.observation = self.env.step(np.clip(noisy, -1.0, 1.0).astype(np.float32))[0]

    def _fit(self, observations: Any, actions: Any, learning_rates: Any) -> None:
        """Fit the actor to labels with one gradient step, on a random batch, for each learning rate."""
        inputs, labels = torch.as_tensor(observations), torch.as_tensor(actions)
        for rate in learning_rates:
            batch = torch.as_tensor(self.random.integers(len(inputs), size=min(_BATCH_SIZE, len(inputs))))
            error = mean_action(self.model, inputs[batch]) - labels[batch]
            loss = (error.pow(2).sum(dim=1) + _EPSILON**2).sqrt().mean()
            self.optimizer.param_groups[0]["lr"] = float(rate)
            self.optimizer.zero_grad()
            torch.autograd.backward(loss)
            self.optimizer.step()
