"""The CUDA kernels: one thread for each sub-environment.

Memory, observations and last observations have the shape (n, field), with the numbers of a field one after the other
(Fortran order). The kernels work on their transposes.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from quadpend_gym.core.jit import inlined
from quadpend_gym.envs.kernel_layout import unpack_rigid_step
from quadpend_gym.gpu import rows
from quadpend_gym.gpu.device_functions import device_function
from quadpend_gym.gpu.rows import BUFFER_SIZE

NO_ROW = -1  # no sub-environment has had an invalid action


class Kernels(NamedTuple):
    """The kernels of one kind of vehicle.

    Attributes:
        start: Starts the next episode of every sub-environment.
        step: Advances every sub-environment by one control period, and starts the next episodes where they ended.
    """

    start: Any
    step: Any


@inlined
def _no_vehicle(settings: Any) -> None:
    """Return None, which stands for the paper's attitude model."""


@cache
def make_kernels(is_rigid: bool) -> Kernels:
    """Return the kernels of rigid vehicles or of the paper's vehicle, which numba compiles when they first run."""
    vehicle_of = device_function(unpack_rigid_step if is_rigid else _no_vehicle)
    read_action, step_row, start_row = (
        device_function(item) for item in (rows.read_action, rows.step_row, rows.start_row)
    )

    def start(memory: Any, counters: Any, keys: Any, settings: Any, episodes: Any, observation: Any) -> None:
        row = cuda.grid(1)
        if row < keys.shape[0]:
            buffer = cuda.local.array((BUFFER_SIZE, 1), np.float64)
            vehicle = vehicle_of(settings)
            start_row(memory.T, counters[0], counters[1], keys, vehicle, episodes, row, buffer, observation.T)

    def step(
        memory: Any,
        counters: Any,
        keys: Any,
        settings: Any,
        episodes: Any,
        action: Any,
        observation: Any,
        final: Any,
        reward: Any,
        ended: Any,
        invalid: Any,
    ) -> None:
        row = cuda.grid(1)
        if row < keys.shape[0]:
            buffer = cuda.local.array((BUFFER_SIZE, 1), np.float64)
            vehicle = vehicle_of(settings)
            if read_action(action, row, buffer):
                value, terminated, truncated = step_row(
                    memory.T, counters[0], settings, vehicle, episodes, row, buffer, observation.T
                )
                reward[row], ended[0, row], ended[1, row] = value, terminated, truncated
                ended[2, row] = terminated | truncated
                if terminated | truncated:
                    for field in range(final.shape[1]):
                        final[row, field] = observation[row, field]
                    start_row(memory.T, counters[0], counters[1], keys, vehicle, episodes, row, buffer, observation.T)
            else:
                invalid[0], reward[row] = row, np.nan
                ended[0, row], ended[1, row], ended[2, row] = False, False, False

    return Kernels(cuda.jit(start), cuda.jit(step))
