"""The control step and the start of one sub-environment, for one thread of a CUDA kernel.

The order of a step is that of `quadpend_gym.envs.step_kernel.control_step`, and every equation is a function that the
CPU kernels use. Where they have blocks of 64 sub-environments in (field, lane) buffers, a thread has a buffer with one
lane. The memory of all sub-environments has the layout of `quadpend_gym.envs.kernel_layout`, but the shape (field, n),
so that neighbouring threads read neighbouring numbers.
"""

from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.envs import kernel_layout, step_kernel
from quadpend_gym.envs.kernel_layout import unpack_settings
from quadpend_gym.envs.outcome import (
    AIR_VELOCITY,
    COMMAND,
    DISTURBANCE,
    OUTCOME_SIZE,
    PARAMETERS,
    REWARD,
    TERMINATED,
)
from quadpend_gym.envs.step_errors import ROUNDING
from quadpend_gym.physics import rigid_kernel
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.kernel import integrate
from quadpend_gym.physics.parameters import PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.physics.rigid_kernel import RIGID, RIGID_LANE_SIZE, RIGID_SIZE, integrate_rigid
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import load
from quadpend_gym.tasks.observation import Target, observe_reference, observe_state, tracking_errors
from quadpend_gym.tasks.references import REFERENCE_SIZE, draw_references, reference_point
from quadpend_gym.tasks.starts import draw_starts
from quadpend_gym.wind import WIND_SIZE

# First fields of the parts of the memory, shape (field, n).
_STATE, _PARAMETERS, _REFERENCE, _RIGID, _ACTION = (
    part.start
    for part in (
        kernel_layout.MEMORY_STATE,
        kernel_layout.MEMORY_PARAMETERS,
        kernel_layout.MEMORY_REFERENCE,
        kernel_layout.MEMORY_RIGID,
        kernel_layout.MEMORY_ACTION,
    )
)
# Parts of the buffer of a thread, shape (BUFFER_SIZE, 1): the outcome, the state with the thrust axis and the further
# state of rigid vehicles, the reference, the last action and the action.
_OWN_STATE, _OWN_REFERENCE, _OWN_LAST, _OWN_ACTION, BUFFER_SIZE = accumulate(
    (OUTCOME_SIZE, RIGID_LANE_SIZE, REFERENCE_SIZE, ACTION_SIZE, ACTION_SIZE)
)
_WIND = DISTURBANCE.start
# Parts of a packed `EpisodeSettings`.
_BOUNDS, _START, _POLE, _HOVER, _FIXED, _IS_FIXED, _LOADS, _STEPS = accumulate(
    (0, 18, 8, 3, ACTION_SIZE, REFERENCE_SIZE, 1, WIND_SIZE)
)


class EpisodeSettings(NamedTuple):
    """What a thread needs to know besides the settings of the step kernel.

    Attributes:
        bounds: Bounds of random references, shape (18,), see `quadpend_gym.tasks.flatten`.
        start: Bounds of random starts, shape (8,).
        pole: See `quadpend_gym.tasks.starts.start_pole`, shape (3,).
        hover: Thrusts of the rotors at hover, N, shape (4,); zero for the paper's vehicle.
        reference: Reference of every episode, shape (20,), if `is_fixed`.
        is_fixed: 1 if all episodes have this reference, 0 if they draw one.
        wind: Constant wind, shape (12,), see `quadpend_gym.wind`.
        steps: Control steps after which an episode is truncated.
    """

    bounds: Floats
    start: Floats
    pole: Floats
    hover: Floats
    reference: Floats
    is_fixed: float
    wind: Floats
    steps: float

    def packed(self) -> Floats:
        """Return all numbers as a flat array, shape (67,)."""
        return np.concatenate([np.atleast_1d(item) for item in self])


@inlined
def _fetch(memory: Any, first: int, size: int, row: int, out: Any) -> None:
    """Copy `size` fields of column `row` from field `first` into a buffer."""
    for field in range(size):
        out[field, 0] = memory[first + field, row]


@inlined
def _keep(buffer: Any, first: int, size: int, row: int, memory: Any) -> None:
    """Copy `size` fields of a buffer into column `row` from field `first`."""
    for field in range(size):
        memory[first + field, row] = buffer[field, 0]


@inlined
def _observe(state: Any, reference: Any, physics: Any, row: int, time: float, observation: Any) -> Any:
    """Write the observation into column `row`, and return the tracking errors."""
    point = reference_point(reference, 0, time)
    observe_reference(point, row, observation)
    tracking = tracking_errors(state, 0, physics[ROD_LENGTH, 0], Target(point.d0, point.d1, point.yaw))
    observe_state(state, 0, tracking, observation, row)
    return tracking


@inlined
def read_action(action: Any, row: int, buffer: Any) -> bool:
    """Copy an action into the buffer and return whether it is valid.

    A component that is outside [−1, 1] by the rounding of float32 is clipped, as in `World.step`.

    Args:
        action: Actions, shape (n, 4).
        row: Number of the sub-environment.
        buffer: Buffer of the thread.
    """
    is_valid = True
    for i in range(ACTION_SIZE):
        value = float(action[row, i])
        is_valid = is_valid & (abs(value) <= 1.0 + ROUNDING)
        buffer[_OWN_ACTION + i, 0] = min(max(value, -1.0), 1.0)
    return is_valid


@inlined
def step_row(
    memory: Any, clock: Any, settings: Any, vehicle: Any, episodes: Any, row: int, buffer: Any, observation: Any
) -> tuple[float, bool, bool]:
    """Advance a sub-environment by one control period under the action in the buffer.

    Args:
        memory: Memory of all sub-environments, shape (47, n), or (62, n) for rigid vehicles, changed in place.
        clock: Control steps since each episode began, shape (n,), changed in place.
        settings: Packed `KernelSettings`.
        vehicle: `RigidStep`, or None for the paper's attitude model.
        episodes: Packed `EpisodeSettings`.
        row: Number of the sub-environment.
        buffer: Buffer of the thread, shape (BUFFER_SIZE, 1).
        observation: Observations, shape (36, n), changed in place.

    Returns:
        The reward, and whether the episode terminated and was truncated.
    """
    period, command_scale, limits, weights, moves_air, substeps = unpack_settings(settings)
    disturbance, velocity = buffer[DISTURBANCE], buffer[AIR_VELOCITY]
    physics, state = buffer[PARAMETERS], buffer[_OWN_STATE:_OWN_REFERENCE]
    reference, action = buffer[_OWN_REFERENCE:_OWN_LAST], buffer[_OWN_ACTION:]
    _fetch(memory, _STATE, STATE_SIZE, row, state)
    _fetch(memory, _PARAMETERS, PARAMETERS_SIZE, row, physics)
    _fetch(memory, _REFERENCE, REFERENCE_SIZE, row, reference)
    for i in range(WIND_SIZE):
        buffer[_WIND + i, 0] = episodes[_LOADS + i]
    if vehicle is None:
        command = buffer[COMMAND]
        step_kernel._command(action, command_scale, 1, command)
        if moves_air:
            add_drag(load(velocity, 0, 0), state, physics, 0, disturbance)
        integrate(state, command, disturbance, physics, 1, period, substeps)
    else:
        last, rigid, switch = buffer[_OWN_LAST:_OWN_ACTION], vehicle.vehicle, vehicle.switch
        _fetch(memory, _RIGID, RIGID_SIZE, row, state[RIGID:])
        _fetch(memory, _ACTION, ACTION_SIZE, row, last)
        integrate_rigid(state, last, action, disturbance, velocity, physics, rigid, 1, period, substeps, switch)
        _keep(action, _ACTION, ACTION_SIZE, row, memory)
    clock[row] += 1
    has_diverged = step_kernel._diverged(state, 0)
    if has_diverged:
        _fetch(memory, _STATE, STATE_SIZE, row, state)
    else:
        _keep(state, _STATE, STATE_SIZE, row, memory)
        if vehicle is not None:
            _keep(state[RIGID:], _RIGID, RIGID_SIZE, row, memory)
    tracking = _observe(state, reference, physics, row, period * clock[row], observation)
    step_kernel._measure(state, action, physics, 0, tracking, limits, weights, buffer)
    terminated = has_diverged | (buffer[TERMINATED, 0] != 0.0)
    return buffer[REWARD, 0], terminated, clock[row] >= episodes[_STEPS]


@inlined
def start_row(
    memory: Any,
    clock: Any,
    episode: Any,
    keys: Any,
    vehicle: Any,
    episodes: Any,
    row: int,
    buffer: Any,
    observation: Any,
) -> None:
    """Start the next episode of a sub-environment, as `World.start_episodes` does.

    Args:
        memory: As in `step_row`.
        clock: As in `step_row`.
        episode: Number of the episode of each sub-environment, shape (n,), changed in place.
        keys: Key of the random stream of each sub-environment, shape (n,).
        vehicle: As in `step_row`.
        episodes: As in `step_row`.
        row: As in `step_row`.
        buffer: As in `step_row`.
        observation: As in `step_row`.
    """
    rows: Any = (row,)
    episode[row] += 1
    clock[row] = 0
    all_references = memory[_REFERENCE : _REFERENCE + REFERENCE_SIZE].T
    all_parameters = memory[_PARAMETERS : _PARAMETERS + PARAMETERS_SIZE].T
    all_states = memory[_STATE : _STATE + STATE_SIZE].T
    bounds, pole = episodes[_START:_POLE], episodes[_POLE:_HOVER]
    if episodes[_IS_FIXED] > 0.0:
        for i in range(REFERENCE_SIZE):
            all_references[row, i] = episodes[_FIXED + i]
    else:
        draw_references(rows, keys, episode, episodes[_BOUNDS:_START], all_references)
    draw_starts(rows, keys, episode, bounds, pole, all_parameters, all_references, all_states)
    physics, state = buffer[PARAMETERS], buffer[_OWN_STATE:_OWN_REFERENCE]
    reference = buffer[_OWN_REFERENCE:_OWN_LAST]
    _fetch(memory, _STATE, STATE_SIZE, row, state)
    _fetch(memory, _PARAMETERS, PARAMETERS_SIZE, row, physics)
    _fetch(memory, _REFERENCE, REFERENCE_SIZE, row, reference)
    if vehicle is not None:
        own = state[RIGID : RIGID + RIGID_SIZE]
        rigid_kernel._rigid_memory(state[:STATE_SIZE].T, episodes[_HOVER:_FIXED], own.T)
        _keep(own, _RIGID, RIGID_SIZE, row, memory)
        for i in range(ACTION_SIZE):
            memory[_ACTION + i, row] = 0.0
    _observe(state, reference, physics, row, 0.0, observation)
