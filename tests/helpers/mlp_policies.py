"""Small MLP policies with random weights."""

from itertools import pairwise
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.mlp_policy import FORMAT, PLAIN_INTERFACE, MlpPolicy

ESTIMATE_ONLY = {"kind": "estimate_only", "base_controller": "flatness"}
RESIDUAL_ACTION = {"kind": "residual_action", "base_controller": "flatness", "action_scale": 1.0}
BANDWIDTH_SCHEDULING = {"kind": "bandwidth_scheduling", "base_controller": "flatness", "action_scale": 1.0}


def layers(*sizes: int, seed: int = 0, scale: float = 0.1) -> list[tuple[Floats32, Floats32]]:
    """Random weights and biases between layers of these sizes."""
    random = np.random.default_rng(seed)

    def draw(*shape: int) -> Floats32:
        return (scale * random.normal(size=shape)).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def card(**fields: Any) -> dict[str, Any]:
    """The card of a policy that receives the present observation alone, with `fields` on top."""
    return {"format": FORMAT, "activation": "relu", "squashed": False, **PLAIN_INTERFACE, **fields}


def mlp_policy(inputs: int, seed: int = 0, **fields: Any) -> MlpPolicy:
    """A policy with two small hidden layers and `fields` on its card."""
    return MlpPolicy(layers(inputs, 8, 6, 4, seed=seed), card(**fields))
