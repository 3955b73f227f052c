"""The inputs of a network, composed of parts.

A part is a function from what a control step knows (`Seen`) and from the memory of the part to some of the inputs and
to its next memory. NumPy and numba compute it for n rows of numbers, CasADi for one row of expressions
(`quadpend_gym.engines.lift`), from which gradients and C come. A memory of zeros is that at the start of an episode.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import Estimate, disturbance_of
from quadpend_baselines.estimation.measurement import observation_of
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, REFERENCE_START

MAGNIFICATION = 10.0  # factor on small deviations in the observation of a `ResidualAction`


class Seen(NamedTuple):
    """What a control step knows before the network acts, arrays of n rows."""

    observation: Any  # errors, shape (n, 36), (n, 27) without velocities, or `LAB`, (n, 37)
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


def _magnified(factor: float, observation: Any) -> Any:
    """Return observations with a factor on what depends on the state, which comes first."""
    size = observation.shape[1]
    states = size - OBSERVATION_SIZE + REFERENCE_START
    return np.asarray((factor,) * states + (1.0,) * (size - states), dtype="f4") * observation


def _observed(factor: float, seen: Seen, memory: Any) -> tuple[Any, Any]:
    return _magnified(factor, seen.observation), memory


def observed_part(size: int, factor: float = 1.0) -> InputPart:
    """Return the observation of the environment, of `size` numbers, with a factor on what depends on the state."""
    return InputPart(size, 0, _observed, factor)


def _estimated(numbers: tuple[str, float, float], seen: Seen, memory: Any) -> tuple[Any, Any]:
    when, rod_length, factor = numbers
    return _magnified(factor, observation_of(Estimate(getattr(seen, when)), rod_length)), memory


def estimated_part(when: Literal["estimate", "later"], rod_length: float, factor: float = 1.0) -> InputPart:
    """Return the observation of an estimated state, as `observed_part`; `when` is the field of `Seen`."""
    return InputPart(OBSERVATION_SIZE, 0, _estimated, (when, rod_length, factor))


def _disturbance(weight: float, seen: Seen, memory: Any) -> tuple[Any, Any]:
    return disturbance_of(seen.estimate, weight), memory


def disturbance_part(weight: float) -> InputPart:
    """Return the estimated disturbance of a vehicle of a weight (N)."""
    return InputPart(DISTURBANCE_SIZE, 0, _disturbance, weight)


def _base_action(factor: float, seen: Seen, memory: Any) -> tuple[Any, Any]:
    return np.float32(factor) * seen.base_action, memory


def base_action_part() -> InputPart:
    """Return the action of the base controller, magnified."""
    return InputPart(ACTION_SIZE, 0, _base_action, MAGNIFICATION)
