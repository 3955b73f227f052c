"""Inputs of a policy on the observation `LAB`: the latest sample relative to the reference's trajectory, and a memory.

The trajectory x_d of the nominal vehicle follows the reference in still air, whose drag it knows. m are the measured
deviations from it, in the axes of the heading, so that no input depends on place or heading. z are those of the state
x_N of `scheduled_gain` when the next action acts, with the thrusts of the rotors, and the wind in the axes of x_N; a_d
follows x_d then. The reference moves on by the latency until then, and x_N by whole periods. The horizontal errors of
position in m and z are limited to a length of 1.2 m, and the vertical ones to ±0.7 m: a vehicle that is farther from
its reference flies as if it were at the limit.

A sample is taken if its position or its direction differs from that of the last sample taken, if it is finite, and if
it satisfies (1). Otherwise m keeps its value, and the time g since the last sample taken grows by the control period T.
If `MOST_REFUSED` samples violate (1) and none is taken between them, the next one that does is taken as a step of the
measurement, in which the vehicle did not move: L and what the filter does not measure go on. With a sample, the lags of
first-order filters of w = (m, u), where u is the last action less its a_d, with w as a line between two samples, are

    (1)  |p − p⁻| < 0.03 m + (3 m/s + |v_d|) g             ⁻: at the last sample taken; v_d: of the reference
         |e − e⁻| < 0.1 rad + 10 rad/s g                   e: Euler angles, whose differences are within half a turn
         |r − r⁻| < 0.06 + 3/s g                           r: direction of the pole
    (2)  L = e^{−g/τ} L⁻ + (1 − e^{−g/τ}) τ/g (w − w⁻),    τ = 0.03, 0.12, 0.5 and 2 s;   L = 0 at the start

L is about τ ẇ where w changes slowly. From L a network can infer velocities, the response to its actions, mean wind and
biases of any vehicle; from z those of the nominal one, with less noise. m, its L and the innovation are divided by the
known noise over `NOISE` where that is above 1; without a sample the first two fade, by e^{−g/0.1 s}.

| part                                                                                     | size | scale              |
|------------------------------------------------------------------------------------------|------|--------------------|
| m: tracking error; r_x r_y, and φ θ ψ, less those of the trajectory                      | 8    | 0.05 m, 0.05, 0.1  |
| u, with g = T in (2)                                                                     | 4    | 0.2                |
| L for each τ                                                                             | 48   | as m and u         |
| a_d                                                                                      | 4    | 1                  |
| acceleration of the reference then, in the axes of the heading, and the rate of its yaw  | 4    | 2 m/s², 1 rad/s    |
| its velocity then in these axes                                                          | 3    | 2 m/s              |
| time since the last sample taken                                                         | 1    | 0.05 s             |
| believed length and mass of the pole                                                     | 2    | of the observation |
| z; its position is that of the vehicle                                                   | 28   | of `deviations`    |
| innovation of `scheduled_gain`                                                           | 8    | 0.005 m, 0.005     |
| a_n = a_d − F z, each component of F z and of a_n within ±1                              | 4    | 1                  |

F is the feedback of equation (2) of `lqg` for the nominal vehicle, with the gains of `lqg` for the paper's vehicle:
they are softer than those tuned for the hummingbird, err more, and fall less.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.lqg import riccati
from quadpend_baselines.controllers.lqr import deviation
from quadpend_baselines.estimation.estimate import LOOP, PLACE, POLE, STATE, YAW, law_inputs, near_angle
from quadpend_baselines.estimation.measurement import measure_in_world
from quadpend_baselines.estimation.prediction import move_reference, store_drag
from quadpend_baselines.estimation.samples import MOST_REFUSED
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.hybrid.scheduled_gain import (
    HEADING,
    MEASURED,
    NOISE,
    SIZE,
    THRUSTS,
    WIND,
    height,
    memory_size,
    observe,
    scheduled_gain,
)
from quadpend_baselines.modelling.equivalent import equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, model_state
from quadpend_baselines.modelling.quantities import VehicleState, bob_offset, calm, limit_length, store_vectors, turn3
from quadpend_baselines.registry import controller
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import body_rate, euler_rate, quaternion_from_euler, rotation_matrix
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, POSITION
from quadpend_gym.physics.vectors import Vec3, add, axpy, load, multiply, norm, store, store_four
from quadpend_gym.tasks.observation import LAB

_TIMES = np.array([0.03, 0.12, 0.5, 2.0])  # τ, s
_GATES = (0.03, 3.0), (0.1, 10.0), (0.06, 3.0)  # of (1): m, rad and 1, and these for each second
_FADE = 0.1  # s
REACH, VERTICAL_REACH = 1.2, 0.7  # limits of horizontal and vertical errors of position, m
_SAME = 1e-6  # a sample that differs by less repeats the last one taken
_FINITE = 1e6  # limit of the absolute numbers of a finite sample, added
_SCALE = np.array([0.05] * 5 + [0.1] * 3 + [0.2] * ACTION_SIZE)
_OF_REFERENCE = np.array([2.0, 2.0, 2.0, 1.0, 2.0, 2.0, 2.0])  # scales
_OF_INNOVATION = 0.005  # scale
_M_SIZE, _W_SIZE = 8, len(_SCALE)  # of m and w
LAGS = slice(_W_SIZE, _W_SIZE * (1 + len(_TIMES)))  # places in the inputs
FOLLOWING = slice(LAGS.stop, LAGS.stop + ACTION_SIZE)  # a_d
_MOTION = FOLLOWING.stop
_GAP = _MOTION + len(_OF_REFERENCE)
_OWN_SIZE = _GAP + 3
LAB_SIZE = _OWN_SIZE + SIZE + len(MEASURED) + ACTION_SIZE
NEAR = slice(LAB_SIZE - ACTION_SIZE, LAB_SIZE)  # a_n, to which `OUTPUT` times the policy's action is added
OUTPUT = 2.0
FILTER = slice(_OWN_SIZE, LAB_SIZE)
# Memory: w; L; what the last sample taken has of `_SAMPLED`; the time since; how many samples violated (1) since; 1
# after the first step; a_d; and that of the filter
_SAMPLED = POSITION, EULER, DIRECTION
_SAMPLE = LAGS.stop
_SINCE, _REFUSED, _BEGUN, _FOLLOWED = _SAMPLE + 9, _SAMPLE + 10, _SAMPLE + 11, _SAMPLE + 12
_OWN_MEMORY = _FOLLOWED + ACTION_SIZE
_POLE = LAB.columns["pole"].start


class Measured(NamedTuple):
    """What a step measures, arrays of n rows."""

    estimate: Floats  # measurements, laid out as an estimate, (n, 106)
    y: Floats  # see `scheduled_gain.observe`, (n, 16)
    sample: Floats  # likewise, (n, 4)
    reference: Floats  # likewise, (n, 4)


@inlined
def _within_reach(error: Vec3) -> Vec3:
    """Return an error of position (m) within its limits."""
    near = limit_length(error, REACH)
    return Vec3(near.x, near.y, min(max(near.z, -VERTICAL_REACH), VERTICAL_REACH))


@compiled
def _measure(
    seen: Floats, packed: Floats, packed_rigid: Floats, areas: tuple[float, float], found: Measured, out: Floats
) -> None:
    """Write what a step measures, and m."""
    pendulum, rigid, measured = unpack_pendulum(packed), unpack_rigid(packed_rigid), found.estimate
    p = pendulum.vehicle
    for row in range(out.shape[0]):
        measure_in_world(seen.T, row, p.rod_length, p.bob_mass, measured.T)
        store_drag(measured.T, row, 1.0, areas, rigid.rotor_drag)
        state, _, reference = law_inputs(measured, row)
        error, _ = deviation(state, calm(), reference, pendulum, rigid)
        tracking = _within_reach(bob_offset(error, p.rod_length)[0])
        for i in range(3):
            out[row, i], out[row, 5 + i] = tracking[i] / _SCALE[i], error.euler[i] / _SCALE[5 + i]
        for i in range(2):
            out[row, 3 + i] = error.direction[i] / _SCALE[3 + i]
            out[row, _GAP + 1 + i] = seen[row, _POLE + i]
        # The measured state has no rates: those of its error are the negative ones of x_d
        sine, cosine = sincos(state.euler.z)
        euler = Vec3(state.euler.x - error.euler.x, state.euler.y - error.euler.y, 0.0)
        rate = body_rate(euler, axpy(-1.0, error.euler_rate, state.euler_rate))
        velocity = axpy(-1.0, error.velocity, turn3(add(state.velocity, reference.d1), -sine, cosine))
        place, r = turn3(state.position, -sine, cosine), turn3(state.direction, -sine, cosine)
        attitude = Vec3(state.euler.x, state.euler.y, error.euler.z)
        for i in range(3):
            found.y[row, i], found.y[row, 3 + i] = place[i], velocity[i]
            found.y[row, 6 + i], found.y[row, 9 + i] = attitude[i], rate[i]
            found.reference[row, i] = measured[row, PLACE + i]
        for i in range(2):
            found.y[row, 12 + i], found.y[row, 14 + i] = r[i], -error.direction_rate[i]
        found.sample[row, 0], found.reference[row, 3] = state.euler.z, reference.yaw.x


@compiled
def _filter(found: Measured, action: Floats, period: float, last: Floats, u: Floats, out: Floats, now: Floats) -> None:
    """Write u, and what the network sees of it and of m, and the next memory, equations (1) and (2)."""
    for row in range(out.shape[0]):
        measured, begun, gap = found.estimate, last[row, _BEGUN], last[row, _SINCE] + period
        is_near, changed, size = 1.0, 0.0, 0.0
        for k, columns in enumerate(_SAMPLED):
            square = 0.0
            for i in range(3):
                before, value = last[row, _SAMPLE + 3 * k + i], measured[row, columns + i]
                change = near_angle(value, before) - before if columns == EULER else value - before
                square += change * change
                size += abs(value)
            speed = _GATES[k][1] + (norm(load(measured.T, PLACE + 3, row)) if columns == POSITION else 0.0)
            is_near *= select(square < (_GATES[k][0] + speed * gap) ** 2, 1.0, 0.0)
            changed += 0.0 if columns == EULER else square
        is_new = select(changed > _SAME**2, select(size < _FINITE, 1.0, 0.0), 0.0)
        refused = last[row, _REFUSED] + is_new * (1.0 - is_near)
        anew = begun * select(refused > MOST_REFUSED + 0.5, 1.0, 0.0)
        is_taken = select(begun > 0.5, max(is_new * is_near, anew), 1.0)
        for i in range(3):
            for k, columns in enumerate(_SAMPLED):
                place = _SAMPLE + 3 * k + i
                now[row, place] = select(is_taken > 0.5, measured[row, columns + i], last[row, place])
        now[row, _REFUSED] = select(is_taken > 0.5, 0.0, refused)
        now[row, _SINCE], now[row, _BEGUN] = select(is_taken > 0.5, 0.0, gap), 1.0
        found.sample[row, 1], found.sample[row, 2], found.sample[row, 3] = is_taken, begun, anew
        out[row, _GAP], fresh = now[row, _SINCE] / 0.05, np.exp(-now[row, _SINCE] / _FADE)
        for i in range(ACTION_SIZE):
            u[row, i] = select(begun > 0.5, action[row, i] - last[row, _FOLLOWED + i], 0.0)
            out[row, _M_SIZE + i] = u[row, i] / _SCALE[_M_SIZE + i]
        for i in range(_W_SIZE):
            taken, time, faded = (is_taken, gap, fresh) if i < _M_SIZE else (1.0, period, 1.0)
            out[row, i] = select(taken > 0.5, out[row, i], last[row, i])
            now[row, i] = out[row, i]
            moves = begun * (1.0 - anew) if i < _M_SIZE else begun
            change = select(moves > 0.5, out[row, i] - last[row, i], 0.0)
            for j in range(len(_TIMES)):
                place = _W_SIZE * (1 + j) + i
                left, ratio = np.exp(-time / _TIMES[j]), _TIMES[j] / time
                lag = left * last[row, place] + (1.0 - left) * ratio * change
                now[row, place] = select(taken > 0.5, lag, last[row, place])
                out[row, place] = faded * now[row, place]
            out[row, i] *= faded


@compiled
def _follow(
    later: Floats, memory: Floats, packed: Floats, packed_rigid: Floats, areas: tuple[float, float], latency: float,
    measured: Floats, outs: tuple[Floats, ...],
) -> None:  # fmt: skip
    """Write the command of x_d (N, N·m), its body rates and thrusts, z, and the motion of the reference, scaled.

    All are those when the next action acts. `later` is x_N in the axes that the memory of the filter has; `measured`
    has the reference now, and is changed.
    """
    pendulum, rigid, (command, desired, z, motion) = unpack_pendulum(packed), unpack_rigid(packed_rigid), outs
    hover = rigid.rotors.hover
    for row in range(z.shape[0]):
        yaw, (sine, cosine) = later[row, 8] + measured[row, YAW], sincos(memory[row, HEADING])
        rotation = rotation_matrix(quaternion_from_euler(Vec3(later[row, 6], later[row, 7], yaw)))
        place = add(load(measured.T, PLACE, row), turn3(load(later.T, 0, row), sine, cosine))
        velocity = turn3(load(later.T, 3, row), sine, cosine)
        euler, rate = Vec3(later[row, 6], later[row, 7], yaw), euler_rate(rotation, load(later.T, 9, row))
        r = turn3(Vec3(later[row, 12], later[row, 13], height(later[row, 12], later[row, 13])), sine, cosine)
        r_dot = turn3(Vec3(later[row, 14], later[row, 15], 0.0), sine, cosine)
        store_vectors(measured.T, STATE, row, VehicleState(place, velocity, euler, rate, r, r_dot))
        measured[row, POLE] = 0.0  # the place is that for a pole of the nominal length
        move_reference(measured.T, row, latency)
        measured[row, YAW] += latency * measured[row, YAW + 1]
        store_drag(measured.T, row, 1.0, areas, rigid.rotor_drag)
        state, _, reference = law_inputs(measured, row)
        error, wanted = deviation(state, calm(), reference, pendulum, rigid)
        store_four(command.T, 0, row, wanted)
        euler = Vec3(state.euler.x - error.euler.x, state.euler.y - error.euler.y, state.euler.z)
        store(desired.T, BODY_RATE, row, body_rate(euler, axpy(-1.0, error.euler_rate, state.euler_rate)))
        thrusts, deviations = multiply(rigid.rotors.unmixing, wanted), model_state(error, 0.0, 1.0)
        store_four(desired.T, ROTOR_THRUST, row, thrusts)
        for i in range(len(deviations)):
            z[row, i] = deviations[i]
        store(z.T, 0, row, _within_reach(error.position))
        for i in range(ACTION_SIZE):
            z[row, THRUSTS + i] = later[row, THRUSTS + i] + hover[i] - thrusts[i]
        for i in range(WIND, SIZE):
            z[row, i] = later[row, i]
        sine, cosine = sincos(state.euler.z)
        acceleration, velocity = turn3(reference.d2, -sine, cosine), turn3(reference.d1, -sine, cosine)
        for i in range(3):
            motion[row, i] = acceleration[i] / _OF_REFERENCE[i]
            motion[row, 4 + i] = velocity[i] / _OF_REFERENCE[4 + i]
        motion[row, 3] = reference.yaw.y / _OF_REFERENCE[3]


@lru_cache(maxsize=256)
def _feedback(simulation: Simulation) -> tuple[Floats, Floats]:
    """Return Fᵀ, shape (28, 4), and the scales of z, shape (28,)."""
    lqg: Any = controller("lqg")
    scales = deviation_scales(simulation.parameters.hover_thrust)[ACTION_SIZE:][:SIZE]
    return riccati(lqg.gains, simulation)[0].T, scales


def _lab(known: tuple[Simulation, tuple[float, float, float]], seen: Seen, memory: Any) -> tuple[Any, Any]:
    LAB.check(seen.observation)
    observed, action = seen.observation.astype(np.float64), seen.action.astype(np.float64)
    (simulation, noise), rows = known, len(observed)
    numbers, model, (feedback, scales) = scheduled_gain(*known), equivalent_model(simulation), _feedback(simulation)
    p, packed = simulation.parameters, (model.packed, numbers.rigid)
    areas = p.quadrotor_drag_area, p.bob_drag_area
    found = Measured(*[np.zeros((rows, size)) for size in (LOOP, MODEL_STATE_SIZE, 4, 4)])
    own, now, u = np.empty((rows, _OWN_SIZE)), np.empty((rows, _OWN_MEMORY)), np.empty((rows, ACTION_SIZE))
    _measure(observed, *packed, areas, found, own)
    _filter(found, action, simulation.period, memory, u, own, now)
    later, innovation = np.empty((rows, SIZE)), np.empty((rows, len(MEASURED)))
    last, after = np.ascontiguousarray(memory[:, _OWN_MEMORY:]), np.empty((rows, memory_size(simulation)))
    observe(numbers, found.y, found.sample, found.reference, action, last, after, later, innovation)
    command, desired = np.empty((rows, 4)), np.zeros((rows, RIGID_SIZE))
    z, motion = np.empty((rows, SIZE)), np.empty((rows, len(_OF_REFERENCE)))
    _follow(later, after, *packed, areas, simulation.latency, found.estimate, (command, desired, z, motion))
    following = plant_of(simulation).actions_for(command, desired)
    own[:, FOLLOWING], own[:, _MOTION:_GAP], now[:, _FOLLOWED:] = following, motion, following
    near = np.clip(following - np.clip(z @ feedback, -1.0, 1.0), -1.0, 1.0)
    inputs = np.concatenate([own, z / scales, innovation / _OF_INNOVATION], axis=1) * _weights(noise)
    return np.concatenate([inputs, near], axis=1), np.concatenate([now, after], axis=1)


@lru_cache(maxsize=16)
def _weights(noise: tuple[float, float, float]) -> Floats:
    """Return the factors of the inputs before a_n."""
    position, euler, direction = (usual / max(known, usual) for known, usual in zip(noise, NOISE, strict=True))
    of_x = [position] * 3 + [direction] * 2 + [euler] * 3 + [1.0] * ACTION_SIZE
    of_innovation = [position] * 3 + [euler] * 3 + [direction] * 2
    others = np.ones(NEAR.start - len(MEASURED) - FOLLOWING.start)
    return np.concatenate([np.tile(of_x, 1 + len(_TIMES)), others, of_innovation])


def lab_part(simulation: Simulation, noise: tuple[float, float, float] = NOISE) -> InputPart:
    """Return the inputs of the table for a nominal vehicle and the known noise of its `Loop`."""
    return InputPart(LAB_SIZE, _OWN_MEMORY + memory_size(simulation), _lab, (simulation, noise))
