"""Delays by whole control steps, and values that are held, for sensors and actuators."""

from quadpend_gym.core.arrays import Booleans, Floats, Integers
from quadpend_gym.core.jit import compiled


@compiled
def _exchange(values: Floats, step: Integers, ring: Floats, steps: int, repeats_first: bool) -> None:
    fields, rows = values.shape
    for row in range(rows):
        slot = (step[row] % steps) * fields
        stored = 0 if repeats_first and step[row] < steps else slot
        for field in range(fields):
            current = values[field, row]
            if step[row] > 0 or not repeats_first:
                values[field, row] = ring[stored + field, row]
            ring[slot + field, row] = current


def delay(values: Floats, step: Integers, memory: Floats, steps: int, repeats_first: bool = False) -> None:
    """Replace the current values by those of `steps` control steps ago, and store the current ones in `memory`.

    Args:
        values: Current values, shape (n, k), columns contiguous, changed in place.
        step: Control steps since the beginning of each episode, shape (n,).
        memory: Ring buffer of the last values, shape (n, steps · k), columns contiguous, changed in place.
        steps: Length of the delay, at least 1.
        repeats_first: What is returned during the first `steps` steps: the values of step 0, or else the initial
            content of `memory`.
    """
    _exchange(values.T, step, memory.T, steps, repeats_first)


def hold(values: Floats, memory: Floats, held: Booleans) -> None:
    """Replace the values of the rows `held`, a mask, by the last ones in `memory`, and store the current ones there."""
    values[held] = memory[held]
    memory[:] = values
