"""Spaces of observations and actions."""

from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios.scenario import Scenario


def observation_space(size: int, **meaning: Any) -> spaces.Box:
    """Return the space of one observation of `size` numbers without bounds: no wind and no start implies any.

    `meaning`, such as the layout, becomes an attribute of the space, as that of `action_space`.
    """
    return _meaning(spaces.Box(-np.inf, np.inf, (size,), np.float32), meaning)


def action_space(**meaning: str) -> spaces.Box:
    """Return the space of one action: thrust and the torques about roll, pitch and yaw, scaled to [−1, 1].

    `meaning`, such as the interface, becomes an attribute of the space. Stable-Baselines3 stores the spaces of a model
    with it, so a file tells what its actions command.
    """
    return _meaning(spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32), meaning)


def spaces_of(scenario: Scenario) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of one observation and of one action in a scenario."""
    layout = scenario.observation
    seen = observation_space(layout.size, layout=tuple(layout))
    return seen, action_space(interface=scenario.interface, vehicle=scenario.vehicle.name)


def _meaning(space: spaces.Box, meaning: dict[str, Any]) -> spaces.Box:
    space.meaning = meaning  # type: ignore[attr-defined]
    return space


def meaning_of(space: Any) -> dict[str, Any]:
    """Return what was given to `observation_space` or `action_space`: nothing for spaces from elsewhere."""
    return dict(getattr(space, "meaning", {}))
