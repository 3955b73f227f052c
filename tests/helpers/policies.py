"""Policies of known quality and synthetic results, for tests of comparisons."""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from quadpend_baselines import Policy, controller
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE, THRUST
from quadpend_gym.scenarios import Scenario
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import FALL_ERROR, EpisodeResults
from quadpend_train.evaluation.metrics import rows
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy


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
    one, error = np.ones_like(rmse), np.zeros((*rmse.shape, 1000), np.float32)
    return EpisodeResults(
        survived,
        one.astype(np.int64),
        rmse,
        np.where(survived, rmse, FALL_ERROR),
        np.where(survived, rmse, np.nan),
        one,
        one,
        one,
        np.where(survived, 0, 1),
        one,
        error,
    )


def synthetic_comparison(duration: float = 10.0, **policies: list[EpisodeResults]) -> Comparison:
    """Return a comparison of synthetic results: a list for each policy, with one entry for each scenario s0, s1, …"""
    found = {(f"s{i}", name): item for name, items in policies.items() for i, item in enumerate(items)}
    found = dict(sorted(found.items(), key=lambda item: item[0][0]))  # by scenario, as `compare` orders them
    table = pd.concat([rows(*cell, results) for cell, results in found.items()], ignore_index=True)
    first = next(iter(found.values()))
    table.attrs = {"provenance": provenance(), "episodes": first.survived.shape[1], "seed": 0}
    learners: dict[str, list[Policy]] = {
        name: [controller("adrc-paper")] * len(items[0].survived) for name, items in policies.items()
    }
    scenarios = {name: Scenario(duration=duration) for name, _ in found}
    return Comparison(table, {cell: results.error for cell, results in found.items()}, scenarios, learners)


ESTIMATE_ONLY = {"kind": "estimate_only", "base_controller": "flatness"}
RESIDUAL_ACTION = {"kind": "residual_action", "base_controller": "flatness", "action_scale": 1.0}


def layers(*sizes: int, seed: int = 0, scale: float = 0.1) -> list[tuple[Floats32, Floats32]]:
    """Random weights and biases between layers of these sizes."""
    random = np.random.default_rng(seed)

    def draw(*shape: int) -> Floats32:
        return (scale * random.normal(size=shape)).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def card(**fields: Any) -> dict[str, Any]:
    """The card of a policy that receives the present observation alone, with `fields` on top."""
    return {"format": FORMAT, "activation": "relu", "squashed": False, "hybrid": None, **fields}


def mlp_policy(inputs: int, seed: int = 0, **fields: Any) -> MlpPolicy:
    """A policy with two small hidden layers and `fields` on its card."""
    return MlpPolicy(layers(inputs, 8, 6, 4, seed=seed), card(**fields))
