"""Inputs of a policy on the observation `LAB`: the latest sample relative to the reference's trajectory, and a memory.

The trajectory x_d of the nominal vehicle follows the reference in still air, whose drag it knows, and a_d follows it at
the time when the next action acts. m are the deviations from it, in the axes of the heading, so that no input depends
on place or heading.

A sample that repeats position and direction of the one before, or lies too far from it (1), is not taken: m keeps its
value, and the time g since the last sample grows by the control period T. With a sample, the lags of first-order
filters of x = (m, u), where u is the last action less its a_d, with x as a line between two samples, are

    (1)  |p − p⁻| < 0.03 m + (3 m/s + |v_d|) g             ⁻: at the last sample; v_d: of the reference
    (2)  L = e^{−g/τ} L⁻ + (1 − e^{−g/τ}) τ/g (x − x⁻),    τ = 0.03, 0.12, 0.5 and 2 s;   L = 0 at the start

L is about τ ẋ where x changes slowly. From L a network can infer velocities, the response to its actions, mean wind and
biases of any vehicle; from the filter of `constant_gain` those of the nominal one, near hover, with less noise. m, its
L and the innovation are divided by the known noise over `NOISE` where that is above 1.

| part                                                                                     | size | scale              |
|------------------------------------------------------------------------------------------|------|--------------------|
| m: tracking error (m); r_x r_y and φ θ less those of the trajectory; ψ_e (rad)           | 8    | 0.05 m, 0.05, 0.1  |
| u, with g = T in (2)                                                                     | 4    | 0.2                |
| L for each τ                                                                             | 48   | as m and u         |
| a_d                                                                                      | 4    | 1                  |
| acceleration of the reference then, in the axes of the heading, and the rate of its yaw  | 4    | 2 m/s², 1 rad/s    |
| its velocity then in these axes                                                          | 3    | 2 m/s              |
| time since the last sample                                                               | 1    | 0.05 s             |
| believed length and mass of the pole                                                     | 2    | of the observation |
| filter of constant gain, and its innovation, see `constant_gain`                         | 36   | its own            |
| a_n = a_d − F z_N, each component of F z_N within ±0.3 and of a_n within ±1              | 4    | 1                  |
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.lqr import deviation
from quadpend_baselines.estimation.estimate import LOOP, PLACE, STATE, law_inputs
from quadpend_baselines.estimation.measurement import measure_in_world
from quadpend_baselines.estimation.prediction import move_reference, store_drag
from quadpend_baselines.hybrid.constant_gain import (
    MEASURED_SIZE,
    NOISE,
    OBSERVED_SIZE,
    apparent_vertical,
    constant_gain,
    observe,
    to_trajectory,
)
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.modelling.equivalent import equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.quantities import calm, turn3
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import body_rate
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, POSITION
from quadpend_gym.physics.vectors import Vec3, axpy, load, multiply, norm, store, store_four
from quadpend_gym.tasks.observation import LAB

_TIMES = np.array([0.03, 0.12, 0.5, 2.0])  # τ, s
_FAR, _SPEED = 0.03, 3.0  # of (1), m and m/s
_NEAR = 0.3  # largest component of F z_N
_SAME = 1e-6  # a sample that differs by less repeats the one before
_SCALE = np.array([0.05] * 5 + [0.1] * 3 + [0.2] * ACTION_SIZE)
_OF_REFERENCE = np.array([2.0, 2.0, 2.0, 1.0, 2.0, 2.0, 2.0])  # scales
_MEASURED, _SIZE = 8, len(_SCALE)
_LAGS = _SIZE * len(_TIMES)
_LAG, _FOLLOWING = _SIZE, _SIZE + _LAGS  # places in the inputs
_MOTION = _FOLLOWING + ACTION_SIZE
_GAP = _MOTION + len(_OF_REFERENCE)
_OWN_SIZE = _GAP + 3
LAB_SIZE = _OWN_SIZE + OBSERVED_SIZE
NEAR = slice(LAB_SIZE - ACTION_SIZE, LAB_SIZE)  # a_n, to which `OUTPUT` times the policy's action is added
OUTPUT = 2.0
LAGS, FILTER = slice(_LAG, _FOLLOWING), slice(_OWN_SIZE, LAB_SIZE)
# Memory: x, L, the last sample's position and direction, the time since, 1 after the first step, a_d, and the filter's
_SAMPLE = _SIZE + _LAGS
_SINCE, _BEGUN, _FOLLOWED = _SAMPLE + 6, _SAMPLE + 7, _SAMPLE + 8
_OWN_MEMORY = _FOLLOWED + ACTION_SIZE
_POLE = LAB.columns["pole"].start


class Deviations(NamedTuple):
    """What a step knows of the trajectory, arrays of n rows."""

    measured: Floats  # measurements as in an estimate, the reference at the time when the next action acts, (n, 106)
    command: Floats  # of the trajectory then, N and N·m, (n, 4)
    desired: Floats  # rates and thrusts of the trajectory then, (n, 11)
    y: Floats  # deviations of position, attitude and direction, (n, 8)
    sample: Floats  # see `constant_gain.observe`, (n, 4)
    reference: Floats  # the same now, see `constant_gain.observe`, (n, 14)


@inlined
def _lift(euler: Vec3, n: Vec3) -> tuple[float, float]:
    """Return the cosine of the roll, and that of the angle between the thrust and n in the axes of the heading."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sincos(euler.x), sincos(euler.y)
    return cos_roll, cos_roll * (n.x * sin_pitch + n.z * cos_pitch) - n.y * sin_roll


@compiled
def _deviations(
    seen: Floats, packed: Floats, packed_rigid: Floats | None, areas: tuple[float, float], latency: float,
    found: Deviations, out: Floats,
) -> None:  # fmt: skip
    """Write what a step knows of the trajectory, m, and what the reference does."""
    pendulum, measured = unpack_pendulum(packed), found.measured
    p, rigid = pendulum.vehicle, None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        measure_in_world(seen.T, row, p.rod_length, p.bob_mass, measured.T)
        if rigid is not None:
            store_drag(measured.T, row, 1.0, areas, rigid.rotor_drag)
        state, _, reference = law_inputs(measured, row)
        error, _ = deviation(state, calm(), reference, pendulum, rigid)
        tracking = axpy(p.rod_length, Vec3(error.direction.x, error.direction.y, 0.0), error.position)
        sine, cosine = sincos(state.euler.z)
        n = apparent_vertical(reference.d2, sine, cosine, p.gravity)
        (cos_roll, lift), (_, wanted) = _lift(state.euler, n), _lift(axpy(-1.0, error.euler, state.euler), n)
        place, direction = to_trajectory(error.position, n), to_trajectory(error.direction, n)
        attitude = Vec3(error.euler.x, cos_roll * error.euler.y, error.euler.z)
        for i in range(3):
            out[row, i], out[row, 5 + i] = tracking[i] / _SCALE[i], error.euler[i] / _SCALE[5 + i]
            found.y[row, i], found.y[row, 3 + i] = place[i], attitude[i]
        for i in range(2):
            out[row, 3 + i], found.y[row, 6 + i] = error.direction[i] / _SCALE[3 + i], direction[i]
            out[row, _GAP + 1 + i] = seen[row, _POLE + i]
        found.sample[row, 0], found.sample[row, 3] = state.euler.z, lift - wanted
        for i in range(12):
            found.reference[row, i] = measured[row, PLACE + i]
        found.reference[row, 12], found.reference[row, 13] = reference.yaw.x, reference.yaw.y
        move_reference(measured.T, row, latency)
        if rigid is not None:
            store_drag(measured.T, row, 1.0, areas, rigid.rotor_drag)
        measured[row, STATE + EULER + 2] += latency * reference.yaw.y
        state, _, reference = law_inputs(measured, row)
        error, command = deviation(state, calm(), reference, pendulum, rigid)
        store_four(found.command.T, 0, row, command)
        if rigid is not None:
            euler = Vec3(state.euler.x - error.euler.x, state.euler.y - error.euler.y, state.euler.z)
            rate = body_rate(euler, axpy(-1.0, error.euler_rate, state.euler_rate))
            store(found.desired.T, BODY_RATE, row, rate)
            store_four(found.desired.T, ROTOR_THRUST, row, multiply(rigid.rotors.unmixing, command))
        sine, cosine = sincos(state.euler.z)
        acceleration, velocity = turn3(reference.d2, -sine, cosine), turn3(reference.d1, -sine, cosine)
        for i in range(3):
            out[row, _MOTION + i] = acceleration[i] / _OF_REFERENCE[i]
            out[row, _MOTION + 4 + i] = velocity[i] / _OF_REFERENCE[4 + i]
        out[row, _MOTION + 3] = reference.yaw.y / _OF_REFERENCE[3]


@compiled
def _filter(
    found: Deviations, action: Floats, following: Floats32, period: float, last: Floats, u: Floats, out: Floats,
    now: Floats,
) -> None:  # fmt: skip
    """Write u, the other inputs and the next memory, equations (1) and (2)."""
    for row in range(out.shape[0]):
        measured, begun, gap = found.measured, last[row, _BEGUN], last[row, _SINCE] + period
        speed = _SPEED + norm(load(found.reference.T, 3, row))
        changed = distance = 0.0
        for i in range(3):
            step = measured[row, POSITION + i] - last[row, _SAMPLE + i]
            turned = measured[row, DIRECTION + i] - last[row, _SAMPLE + 3 + i]
            distance += step * step
            changed += step * step + turned * turned
        is_taken = select(changed > _SAME**2, select(distance < (_FAR + speed * gap) ** 2, 1.0, 0.0), 0.0)
        is_taken = select(begun > 0.5, is_taken, 1.0)
        for i in range(3):
            place = _SAMPLE + i
            now[row, place] = select(is_taken > 0.5, measured[row, POSITION + i], last[row, place])
            now[row, place + 3] = select(is_taken > 0.5, measured[row, DIRECTION + i], last[row, place + 3])
        now[row, _SINCE], now[row, _BEGUN] = select(is_taken > 0.5, 0.0, gap), 1.0
        found.sample[row, 1], found.sample[row, 2] = now[row, _SINCE], begun
        out[row, _GAP] = now[row, _SINCE] / 0.05
        for i in range(ACTION_SIZE):
            out[row, _FOLLOWING + i] = now[row, _FOLLOWED + i] = following[row, i]
            u[row, i] = select(begun > 0.5, action[row, i] - last[row, _FOLLOWED + i], 0.0)
            out[row, _MEASURED + i] = u[row, i] / _SCALE[_MEASURED + i]
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


def _lab(known: tuple[Simulation, tuple[float, float, float]], seen: Seen, memory: Any) -> tuple[Any, Any]:
    LAB.check(seen.observation)
    observed, action = seen.observation.astype(np.float64), seen.action.astype(np.float64)
    simulation, numbers = known[0], constant_gain(*known)
    rows, model = len(observed), equivalent_model(simulation)
    sizes = LOOP, ACTION_SIZE, RIGID_SIZE, MEASURED_SIZE, 4, 14
    found = Deviations(*[np.zeros((rows, size)) for size in sizes])
    out, now, u = np.empty((rows, _OWN_SIZE)), np.empty((rows, _OWN_MEMORY)), np.empty((rows, ACTION_SIZE))
    areas = simulation.parameters.quadrotor_drag_area, simulation.parameters.bob_drag_area
    _deviations(observed, model.packed, model.packed_rigid, areas, simulation.latency, found, out)
    following = plant_of(simulation).actions_for(found.command, found.desired)
    _filter(found, action, following, simulation.period, memory, u, out, now)
    estimated, after = np.empty((rows, OBSERVED_SIZE)), np.empty((rows, numbers.memory_size))
    observe(numbers, found.y, found.sample, found.reference, u, memory[:, _OWN_MEMORY:], after, estimated)
    near = np.clip(following + np.clip(estimated[:, -ACTION_SIZE:], -_NEAR, _NEAR), -1.0, 1.0)
    inputs = np.concatenate([out, estimated[:, :-ACTION_SIZE]], axis=1) * _weights(known[1])
    return np.concatenate([inputs, near], axis=1), np.concatenate([now, after], axis=1)


@lru_cache(maxsize=16)
def _weights(noise: tuple[float, float, float]) -> Floats:
    """Return the factors of the inputs before a_n."""
    position, euler, direction = (usual / max(known, usual) for known, usual in zip(noise, NOISE, strict=True))
    of_x = [position] * 3 + [direction] * 2 + [euler] * 3 + [1.0] * ACTION_SIZE
    of_innovation = [position] * 3 + [euler] * 3 + [direction] * 2
    others = np.ones(NEAR.start - MEASURED_SIZE - _FOLLOWING)
    return np.concatenate([np.tile(of_x, 1 + len(_TIMES)), others, of_innovation])


def lab_part(simulation: Simulation, noise: tuple[float, float, float] = NOISE) -> InputPart:
    """Return the inputs of the table for a nominal vehicle and the known noise of its `Loop`."""
    memory_size = _OWN_MEMORY + constant_gain(simulation, noise).memory_size
    return InputPart(LAB_SIZE, memory_size, _lab, (simulation, noise))
