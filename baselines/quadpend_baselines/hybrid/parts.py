"""The inputs of a network, composed of parts.

A part is a function from what a control step knows (`Seen`) and from the memory of the part to some of the inputs and
to its next memory. NumPy and numba compute it for n rows of numbers, CasADi for one row of expressions
(`quadpend_gym.engines.lift`), from which gradients and C come. A memory of zeros is that at the start of an episode.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import Estimate, disturbance_of
from quadpend_baselines.estimation.measurement import observation_of
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, REFERENCE_START

_MAGNIFICATION = np.float32(10.0)  # factor on small deviations in the observation of a `ResidualAction`


class Seen(NamedTuple):
    """What a control step knows before the network acts, arrays of n rows."""

    observation: Any  # of the environment, shape (n, 36), or (n, 27) without velocities
    action: Any  # the last applied action, shape (n, 4); zeros at the start of an episode
    base_action: Any  # the action of the base controller, shape (n, 4); zeros if it does not act
    estimate: Any  # the estimate of the base controller's observers, shape (n, k)
    later: Any  # the same at the time when the next action acts


class InputPart(NamedTuple):
    """A part of the inputs: their number, the size of the memory, and (numbers, seen, memory) → (inputs, memory)."""

    size: int
    memory_size: int
    function: Callable[[Any, Seen, Any], tuple[Any, Any]]
    numbers: Any  # settings of the function


def read_inputs(parts: Sequence[InputPart], seen: Seen, memory: Floats) -> tuple[Floats, Floats]:
    """Return the inputs of a network, shape (n, m), and the memories of the parts, one beside the other, (n, k)."""
    inputs, memories, first = [], [], 0
    for part in parts:
        found, after = part.function(part.numbers, seen, memory[:, first : first + part.memory_size])
        inputs.append(found)
        memories.append(after)
        first += part.memory_size
    return np.concatenate(inputs, axis=1), np.concatenate(memories, axis=1)


def _observed(columns: tuple[int, ...], seen: Seen, memory: Any) -> tuple[Any, Any]:
    return seen.observation[:, list(columns)], memory


def observed_part(columns: Iterable[int]) -> InputPart:
    """Return columns of the observation of the environment."""
    chosen = tuple(columns)
    return InputPart(len(chosen), 0, _observed, chosen)


class Vehicle(NamedTuple):
    """What estimates are relative to."""

    rod_length: float  # m
    weight: float  # N


def _estimated(vehicle: Vehicle, seen: Seen, memory: Any) -> tuple[Any, Any]:
    observed = observation_of(Estimate(seen.later), vehicle.rod_length)
    return np.concatenate([observed, disturbance_of(seen.estimate, vehicle.weight)], axis=1), memory


def estimated_part(vehicle: Vehicle) -> InputPart:
    """Return the observation of the estimated state in which the next action acts, and the estimated disturbance."""
    return InputPart(OBSERVATION_SIZE + DISTURBANCE_SIZE, 0, _estimated, vehicle)


def _estimated_near(vehicle: Vehicle, seen: Seen, memory: Any) -> tuple[Any, Any]:
    observed = observation_of(Estimate(seen.estimate), vehicle.rod_length)
    return _magnified(observed, disturbance_of(seen.estimate, vehicle.weight), seen.base_action), memory


def _measured(vehicle: Vehicle, seen: Seen, memory: Any) -> tuple[Any, Any]:
    return np.concatenate([seen.observation, disturbance_of(seen.estimate, vehicle.weight)], axis=1), memory


def _measured_near(vehicle: Vehicle, seen: Seen, memory: Any) -> tuple[Any, Any]:
    disturbance = disturbance_of(seen.estimate, vehicle.weight)
    return _magnified(seen.observation, disturbance, seen.base_action), memory


def _magnified(observed: Any, disturbance: Any, base_action: Any) -> Any:
    states = observed.shape[1] - OBSERVATION_SIZE + REFERENCE_START
    parts = _MAGNIFICATION * observed[:, :states], observed[:, states:], disturbance, _MAGNIFICATION * base_action
    return np.concatenate(parts, axis=1)


def residual_part(vehicle: Vehicle) -> InputPart:
    """Return the observation of the estimated state, the estimated disturbance, and the base controller's action."""
    return InputPart(OBSERVATION_SIZE + DISTURBANCE_SIZE + ACTION_SIZE, 0, _estimated_near, vehicle)


def measured_part(vehicle: Vehicle, size: int) -> InputPart:
    """Return the observation, of `size` numbers, and the estimated disturbance."""
    return InputPart(size + DISTURBANCE_SIZE, 0, _measured, vehicle)


def measured_residual_part(vehicle: Vehicle, size: int) -> InputPart:
    """Return the same, and the base controller's action."""
    return InputPart(size + DISTURBANCE_SIZE + ACTION_SIZE, 0, _measured_near, vehicle)
