"""Small learned policies with random weights."""

from itertools import pairwise
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.training.settings import TrainSettings

PLAIN = TrainSettings().view()  # of the observation alone


def layers(*sizes: int, seed: int = 0, scale: float = 0.1) -> list[tuple[Floats32, Floats32]]:
    """Random weights and biases from one size to the next."""
    random = np.random.default_rng(seed)

    def draw(*shape: int) -> Floats32:
        return (scale * random.normal(size=shape)).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def card(view: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """A card that says how to fly, with changes to it and to its view."""
    seen = {**PLAIN, **(view or {})}
    return {"format": FORMAT, "activation": "relu", "squashed": False, "view": seen, **changes}


def learned(inputs: int, view: dict[str, Any] | None = None, seed: int = 0, **changes: Any) -> MlpPolicy:
    """A policy with two small hidden layers."""
    return MlpPolicy(layers(inputs, 8, 6, 4, seed=seed), card(view, **changes))
