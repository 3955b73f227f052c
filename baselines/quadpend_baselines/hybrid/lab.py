"""Inputs of a policy on the observation `LAB`: the latest sample relative to the reference's trajectory, and a memory.

No observer estimates anything. The trajectory x_d, a_d of the nominal vehicle follows the reference in still air, whose
drag it knows. m are the deviations from it, in the axes of the heading, so that no input depends on place or heading.

A sample that repeats the one before, or lies too far from it (1), is not taken: m keeps its value, and the time g since
the last sample grows by the control period T. With a sample, the lags of first-order filters of x = (m, a_{k−1} − a_d),
with x as a line between two samples, are

    (1)  |p − p⁻| < 0.03 m + 3 m/s · g                     ⁻: at the last sample
    (2)  L = e^{−g/τ} L⁻ + (1 − e^{−g/τ}) τ/g (x − x⁻),    τ = 0.02, 0.06, 0.2, 0.6 and 2 s;   L = 0 at the start
    (3)  N = e^{−g/τ} N⁻ + (1 − e^{−g/τ}) L,               the first three τ;                  N = 0 at the start

L is about τ ẋ where x changes slowly. From L and N a network can infer velocities, the response to its actions, mean
wind and biases.

| part                                                                                     | size | scale              |
|------------------------------------------------------------------------------------------|------|--------------------|
| m: tracking error (m); r_x r_y and φ θ less those of the trajectory; ψ_e (rad)           | 8    | 0.05 m, 0.05, 0.1  |
| a_{k−1} − a_d; g is T for it                                                             | 4    | 0.2                |
| L for each τ, then N                                                                     | 96   | as m and action    |
| a_d                                                                                      | 4    | 1                  |
| acceleration of the reference in the axes of the heading, and the rate of its yaw        | 4    | 2 m/s², 1 rad/s    |
| velocity of the reference in these axes                                                  | 3    | 2 m/s              |
| time since the last sample                                                               | 1    | 0.05 s             |
| believed length and mass of the pole                                                     | 2    | of the observation |
"""

from typing import Any

import numpy as np

from quadpend_baselines.controllers.lqr import deviation
from quadpend_baselines.estimation.estimate import LOOP, law_inputs
from quadpend_baselines.estimation.measurement import measure_in_world
from quadpend_baselines.estimation.prediction import store_drag
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.modelling.equivalent import equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.quantities import calm, turn3
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.attitude import body_rate
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, POSITION
from quadpend_gym.physics.vectors import Vec3, axpy, multiply, store, store_four
from quadpend_gym.tasks.observation import LAB

_TIMES = np.array([0.02, 0.06, 0.2, 0.6, 2.0])  # τ, s
_TWICE = 3  # of them have N, too
_FAR, _SPEED = 0.03, 3.0  # of (1), m and m/s
_SAME = 1e-6  # a sample that differs by less repeats the one before
_SCALE = np.array([0.05] * 5 + [0.1] * 3 + [0.2] * ACTION_SIZE)
_OF_REFERENCE = np.array([2.0, 2.0, 2.0, 1.0, 2.0, 2.0, 2.0])  # scales
_MEASURED, _SIZE = 8, len(_SCALE)
_LAGS = _SIZE * len(_TIMES)
_FILTERED = _LAGS + _SIZE * _TWICE
_LAG, _FOLLOWING = _SIZE, _SIZE + _FILTERED  # places in the inputs
FOLLOWING = slice(_FOLLOWING, _FOLLOWING + ACTION_SIZE)  # a_d, to which the policy's action is added
_MOTION = _FOLLOWING + ACTION_SIZE
_GAP = _MOTION + len(_OF_REFERENCE)
LAB_SIZE = _GAP + 3
# Memory: x, L, N, the last sample's position and direction, the time since, and 1 after the first step of an episode
_SAMPLE = _SIZE + _FILTERED
_SINCE, _BEGUN = _SAMPLE + 6, _SAMPLE + 7
REMEMBERED_SIZE = _BEGUN + 1
_POLE = LAB.columns["pole"].start


@compiled
def _deviations(
    seen: Floats, packed: Floats, packed_rigid: Floats | None, areas: tuple[float, float], measured: Floats,
    command: Floats, desired: Floats, out: Floats,
) -> None:  # fmt: skip
    """Write measurements, the command and rates and thrusts of the trajectory, m, and what the reference does."""
    pendulum = unpack_pendulum(packed)
    p, rigid = pendulum.vehicle, None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        measure_in_world(seen.T, row, p.rod_length, p.bob_mass, measured.T)
        if rigid is not None:
            store_drag(measured.T, row, 1.0, areas, rigid.rotor_drag)
        state, _, reference = law_inputs(measured, row)
        error, wanted = deviation(state, calm(), reference, pendulum, rigid)
        store_four(command.T, 0, row, wanted)
        if rigid is not None:
            euler = Vec3(state.euler.x - error.euler.x, state.euler.y - error.euler.y, state.euler.z)
            store(desired.T, BODY_RATE, row, body_rate(euler, axpy(-1.0, error.euler_rate, state.euler_rate)))
            store_four(desired.T, ROTOR_THRUST, row, multiply(rigid.rotors.unmixing, wanted))
        tracking = axpy(p.rod_length, Vec3(error.direction.x, error.direction.y, 0.0), error.position)
        sine, cosine = sincos(state.euler.z)
        acceleration, velocity = turn3(reference.d2, -sine, cosine), turn3(reference.d1, -sine, cosine)
        for i in range(3):
            out[row, i], out[row, 5 + i] = tracking[i] / _SCALE[i], error.euler[i] / _SCALE[5 + i]
            out[row, _MOTION + i] = acceleration[i] / _OF_REFERENCE[i]
            out[row, _MOTION + 4 + i] = velocity[i] / _OF_REFERENCE[4 + i]
        for i in range(2):
            out[row, 3 + i] = error.direction[i] / _SCALE[3 + i]
            out[row, _GAP + 1 + i] = seen[row, _POLE + i]
        out[row, _MOTION + 3] = reference.yaw.y / _OF_REFERENCE[3]


@compiled
def _filter(
    measured: Floats, action: Floats, following: Floats32, period: float, last: Floats, out: Floats, now: Floats
) -> None:
    """Write the other inputs and the next memory, equations (1) to (3)."""
    for row in range(out.shape[0]):
        begun, gap = last[row, _BEGUN], last[row, _SINCE] + period
        changed = distance = 0.0
        for i in range(3):
            step = measured[row, POSITION + i] - last[row, _SAMPLE + i]
            turned = measured[row, DIRECTION + i] - last[row, _SAMPLE + 3 + i]
            distance += step * step
            changed += step * step + turned * turned
        is_taken = select(changed > _SAME**2, select(distance < (_FAR + _SPEED * gap) ** 2, 1.0, 0.0), 0.0)
        is_taken = select(begun > 0.5, is_taken, 1.0)
        for i in range(3):
            place = _SAMPLE + i
            now[row, place] = select(is_taken > 0.5, measured[row, POSITION + i], last[row, place])
            now[row, place + 3] = select(is_taken > 0.5, measured[row, DIRECTION + i], last[row, place + 3])
        now[row, _SINCE], now[row, _BEGUN] = select(is_taken > 0.5, 0.0, gap), 1.0
        out[row, _GAP] = now[row, _SINCE] / 0.05
        for i in range(ACTION_SIZE):
            out[row, _FOLLOWING + i] = following[row, i]
            out[row, _MEASURED + i] = (action[row, i] - following[row, i]) / _SCALE[_MEASURED + i]
        for i in range(_SIZE):
            taken, time = (is_taken, gap) if i < _MEASURED else (1.0, period)
            out[row, i] = select(taken > 0.5, out[row, i], last[row, i])
            now[row, i] = out[row, i]
            change = select(begun > 0.5, out[row, i] - last[row, i], 0.0)
            for j in range(len(_TIMES)):
                place = _SIZE * (1 + j) + i
                left, ratio = np.exp(-time / _TIMES[j]), _TIMES[j] / time
                lag = left * last[row, place] + (1.0 - left) * ratio * change
                now[row, place] = select(taken > 0.5, lag, last[row, place])
                out[row, _LAG + _SIZE * j + i] = now[row, place]
                if j < _TWICE:
                    again = place + _LAGS
                    twice = left * last[row, again] + (1.0 - left) * now[row, place]
                    now[row, again] = select(taken > 0.5, twice, last[row, again])
                    out[row, _LAG + _LAGS + _SIZE * j + i] = now[row, again]


def _lab(simulation: Simulation, seen: Seen, memory: Any) -> tuple[Any, Any]:
    LAB.check(seen.observation)
    observed, action = seen.observation.astype(np.float64), seen.action.astype(np.float64)
    rows, model = len(observed), equivalent_model(simulation)
    measured, command, desired = np.zeros((rows, LOOP)), np.empty((rows, 4)), np.empty((rows, RIGID_SIZE))
    out, now = np.empty((rows, LAB_SIZE)), np.empty((rows, REMEMBERED_SIZE))
    areas = simulation.parameters.quadrotor_drag_area, simulation.parameters.bob_drag_area
    _deviations(observed, model.packed, model.packed_rigid, areas, measured, command, desired, out)
    following = plant_of(simulation).actions_for(command, desired)
    _filter(measured, action, following, simulation.period, memory, out, now)
    return out, now


def lab_part(simulation: Simulation) -> InputPart:
    """Return the inputs of the table for a nominal vehicle."""
    return InputPart(LAB_SIZE, REMEMBERED_SIZE, _lab, simulation)
