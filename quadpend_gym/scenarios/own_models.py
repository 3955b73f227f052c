"""Models of the user's own code in scenarios."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_gym.core.factories import describe_error
from quadpend_gym.core.models import is_project_class
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.wind import WindFromFactory


def own_models(value: Any) -> list[Any]:
    """Return all objects in a scenario that are made by the user's own code, which no hash of a scenario covers."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [model for item in value for model in own_models(item)]
    if value is None or isinstance(value, str | int | float):
        return []
    if isinstance(value, WindFromFactory) or not is_project_class(type(value)) or not is_dataclass(value):
        return [value]
    return own_models([getattr(value, item.name) for item in fields(value)])


def check_own_models(name: str, scenario: Scenario) -> None:
    """Run a scenario with own models for two steps, so that their errors are found before a long evaluation."""
    if not own_models(scenario):
        return
    try:
        env = scenario.make_vec(2, AutoresetMode.SAME_STEP)
        env.reset(seed=0)
        for _ in range(2):
            env.step(np.zeros(env.action_space.shape, np.float32))
    except Exception as error:  # own code may raise exceptions of any type
        raise ValueError(f"the scenario {name} does not run: {describe_error(error)}") from error
