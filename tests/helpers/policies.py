"""Policies of known quality and synthetic results, for tests of comparisons."""

from typing import Any

import numpy as np

from quadpend_baselines import ADRC
from quadpend_gym.physics.state import ACTION_SIZE, THRUST
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE
from quadpend_train.evaluation.episodes import FALL_ERROR, EpisodeResults

_ERROR_X = OBSERVATION_FIELDS["tracking_error"].start


class BiasedADRC:
    """ADRC that tracks the reference with a constant offset (m) in x."""

    def __init__(self, distance: float) -> None:
        self.distance, self.adrc = distance, ADRC("matched")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        shifted = observation.copy()
        shifted[:, _ERROR_X] -= self.distance / float(OBSERVATION_SCALE[_ERROR_X])
        return self.adrc.predict(shifted, state, episode_start)


class NoisyADRC:
    """ADRC with small random actions added, which depend on the seed."""

    def __init__(self, seed: int) -> None:
        self.random, self.adrc = np.random.default_rng(seed), ADRC("matched")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        action, memory = self.adrc.predict(observation, state, episode_start)
        noise = self.random.normal(0.0, 0.02, action.shape)
        return np.clip(action + noise, -1.0, 1.0).astype(np.float32), memory


class ZeroThrust:
    """A policy that commands no thrust."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        action = np.zeros((len(observation), ACTION_SIZE), np.float32)
        action[:, THRUST] = -1.0
        return action, None


def synthetic_results(rmse: Any, survived: Any = True) -> EpisodeResults:
    """Return synthetic results with the given RMSE (m) of each episode, shape (n,) or (s, n)."""
    rmse = np.atleast_2d(np.asarray(rmse, np.float64))
    survived = np.broadcast_to(survived, rmse.shape)
    one, error = np.ones_like(rmse), np.zeros((*rmse.shape, EPISODE_STEPS), np.float32)
    return EpisodeResults(
        survived,
        one.astype(np.int64),
        rmse,
        np.where(survived, rmse, FALL_ERROR),
        np.where(survived, rmse, np.nan),
        one,
        one,
        one,
        error,
    )
