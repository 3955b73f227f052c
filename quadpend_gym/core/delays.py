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
    """Replace the values, shape (n, k), by those of `steps` control steps ago, and store them in `memory`.

    `step` is the number of control steps since each episode began, `memory` a ring buffer, shape (n, steps · k). Its
    columns and those of the values are contiguous. During the first steps of an episode the values of step 0 are
    repeated, or else those that `memory` has had from the beginning.
    """
    _exchange(values.T, step, memory.T, steps, repeats_first)


def hold(values: Floats, memory: Floats, held: Booleans) -> None:
    """Replace the values of the rows `held`, a mask, by the last ones in `memory`, and store the current ones there."""
    values[held] = memory[held]
    memory[:] = values
