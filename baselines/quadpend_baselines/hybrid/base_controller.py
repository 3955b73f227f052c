"""Functions that the hybrids share: find, check and redesign the base controller, and read its estimates."""

from copy import copy
from typing import Any, TypeVar

import numpy as np

from quadpend_baselines.estimation.loop import Loop, design_for
from quadpend_baselines.hybrid.protocol import Hybrid
from quadpend_baselines.registry import controller
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.validation import check_number
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, REFERENCE_START

LARGEST_ACTION_SCALE = 3.0
MAGNIFICATION = np.float32(10.0)  # factor on small deviations in the policy's observation

_DEFAULT = Simulation()
HybridType = TypeVar("HybridType", bound=Hybrid)


def find_base_controller(value: Any) -> tuple[Any, str | None]:
    """Return the base controller and its name, which is None if `value` is a controller.

    Args:
        value: A name from `quadpend_baselines.CONTROLLERS`, or a controller that estimates the disturbance.

    Raises:
        TypeError: If `value` is neither a name nor a controller that estimates the disturbance.
        ValueError: If there is no controller with this name.
    """
    found, name = (controller(value), value) if isinstance(value, str) else (value, None)
    if not hasattr(found, "estimated_disturbance"):
        raise TypeError(f"base_controller must be a controller that estimates the disturbance, not {value!r}")
    return found, name


def check_action_scale(value: Any) -> float:
    """Return the action scale κ after a check that it is above zero and at most 3.

    Raises:
        TypeError: If it is not a number.
        ValueError: If it is out of range.
    """
    if check_number(value, "action_scale", 0.0, LARGEST_ACTION_SCALE) == 0.0:
        raise ValueError("action_scale must be above zero, not 0")
    return float(value)


def control_period(base_controller: Any) -> float:
    """Return the control period for which a controller is designed, s; the default if it has no nominal simulation."""
    return float(getattr(base_controller, "simulation", _DEFAULT).period)


def change_simulation(hybrid: HybridType, simulation: Simulation, loop: Loop | None) -> HybridType:
    """Return `hybrid` with its base controller designed for another nominal simulation and loop."""
    other = copy(hybrid)
    other.base_controller = design_for(hybrid.base_controller, simulation, loop or Loop())
    return other


def name_of_base_controller(hybrid: Hybrid) -> str:
    """Return the name by which the base controller was given.

    Raises:
        ValueError: If it was given as an object.
    """
    if hybrid.base_controller_name is None:
        raise ValueError(
            "a hybrid can be converted to plain data only if its base controller is given by name, not as"
            f" {hybrid.base_controller!r}"
        )
    return hybrid.base_controller_name


def estimate_size(base_controller: Any, size: int) -> int:
    """Return the total size of the two parts that `estimate` returns, for an observation of `size` components."""
    return (OBSERVATION_SIZE if _estimates_state(base_controller) else size) + DISTURBANCE_SIZE


def estimate(base_controller: Any, observation: Floats32, memory: Any) -> tuple[Floats32, Floats]:
    """Return the estimated observation and the estimated disturbance.

    Args:
        base_controller: The controller.
        observation: Observation of the environment, shape (n, 36) or (n, 27).
        memory: Memory of the controller after this observation.

    Returns:
        The observation of the estimated state, shape (n, 36), or a copy of `observation` if the controller does not
        estimate the whole state; and the estimated disturbance, shape (n, 9).
    """
    if _estimates_state(base_controller):
        estimated = base_controller.estimated_observation(observation, memory)
    else:
        estimated = observation.copy()
    return estimated, base_controller.estimated_disturbance(memory)


def observe_ahead(
    base_controller: Any, observation: Floats32, memory: Any, episode_start: Any
) -> tuple[Floats32, Floats, Any, Floats32 | None]:
    """Update the estimates of the base controller, and predict the state through known delays and lags.

    Args:
        base_controller: The controller.
        observation: Observation of the environment, shape (n, 36) or (n, 27).
        memory: Memory of the controller after the last step; None at the first step.
        episode_start: Mask of the rows whose episode begins with this observation, shape (n,).

    Returns:
        Observation and disturbance as from `estimate`, but in the state at the time when the next action acts; the
        memory of the controller; and its action, shape (n, 4), or None if `control` computes it from this memory.
    """
    if not computes_action_later(base_controller):
        action, memory = base_controller.predict(observation, memory, episode_start)
        return *estimate(base_controller, observation, memory), memory, action
    memory = base_controller.update(observation, memory, episode_start)
    predicted = base_controller.predicted_observation(observation, memory)
    return predicted, base_controller.estimated_disturbance(memory), memory, None


def computes_action_later(base_controller: Any) -> bool:
    """Return whether a controller computes its action in a method of its own, after its estimates."""
    return hasattr(base_controller, "predicted_observation")


def magnify_state(observation: Floats32) -> Floats32:
    """Multiply the part of an observation that depends on the state by `MAGNIFICATION`, in place, and return it."""
    observation[:, : REFERENCE_START - OBSERVATION_SIZE] *= MAGNIFICATION
    return observation


def _estimates_state(base_controller: Any) -> bool:
    return hasattr(base_controller, "estimated_observation")
