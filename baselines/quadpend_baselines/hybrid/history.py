"""The latest observations and actions as inputs of a network, as `quadpend_gym.wrappers.HistoryWrapper` stacks them.

The observations come first, then the actions, both with the oldest first. At the start of an episode the history holds
copies of the first observation and zero actions.
"""

from typing import Any

import numpy as np

from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_gym.physics.state import ACTION_SIZE


def _history(numbers: tuple[int, int], seen: Seen, memory: Any) -> tuple[Any, Any]:
    observations, actions = numbers
    size, new = seen.observation.shape[1], seen.observation
    before = (observations - 1) * size
    # The memory has the observations and actions before the last ones, and 1 after the first step of an episode.
    earlier = np.where(memory[:, -1:] >= 1.0, memory[:, :before], np.tile(new, (1, observations - 1)))
    stacked = np.concatenate([earlier, new], axis=1)
    acted = np.concatenate([memory[:, before:-1], seen.action], axis=1)[:, : ACTION_SIZE * actions]
    after = [stacked[:, size:], acted[:, ACTION_SIZE:], np.ones((len(memory), 1))]
    return np.concatenate([stacked, acted], axis=1), np.concatenate(after, axis=1)


def history_part(observations: int, actions: int, size: int) -> InputPart:
    """Return the latest observations, of `size` numbers, the present one included, and the latest actions."""
    memory_size = (observations - 1) * size + ACTION_SIZE * max(actions - 1, 0) + 1
    return InputPart(observations * size + ACTION_SIZE * actions, memory_size, _history, (observations, actions))
