"""Spaces of observations and actions."""

from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS


def observed_columns(scenario: Scenario) -> Any:
    """Return the columns of the full observation that a scenario has: all, or those without velocities."""
    return OUTPUT_FEEDBACK_COLUMNS if scenario.output_feedback else slice(None)


def observation_space(size: int = OBSERVATION_SIZE) -> spaces.Box:
    """Return the space of one observation of `size` numbers without bounds: no wind and no start implies any."""
    return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def action_space(**meaning: str) -> spaces.Box:
    """Return the space of one action: thrust and the torques about roll, pitch and yaw, scaled to [−1, 1].

    `meaning`, such as the interface, becomes an attribute of the space. Stable-Baselines3 stores the spaces of a model
    with it, so a file tells what its actions command.
    """
    space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
    space.meaning = meaning  # type: ignore[attr-defined]
    return space


def action_meaning(space: Any) -> dict[str, str]:
    """Return what was given to `action_space`: nothing for spaces from elsewhere."""
    return dict(getattr(space, "meaning", {}))
