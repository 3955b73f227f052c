"""A Kalman filter of constant gain for the deviations from the reference's trajectory, as a memory of a network.

z are the deviations of the state of `modelling.linear_model` (with the thrusts f of the rotors) from the trajectory,
and the wind d; y are those of position, attitude and direction; and u is the action less that of the trajectory, which
acts N periods later. Their axes are those of the heading at the last sample, turned with the vertical to n, the
direction of the acceleration of the reference less that of gravity, where an accelerated flight is nearly as linear as
hover; A and B keep g.
With A, B, C and the gain L of `lqg`'s filter,

    (1)  z⁻ = R(A z + B u_{k−1−N} + T g c e_ż − j)   c: cosine of the tilt from n less that of the trajectory, at
                                                     the last sample; j: jump of the reference; R: to the new axes
    (2)  z = z⁻ + (L + s ΔL) i,                  i = y − C z⁻, limited; without a new sample i = 0
    (3)  z_N = A^N z + A^{N−1} B u_{k−N} + … + B u_{k−1}, when the next action acts

s is that of equation (4) of `estimation.kalman`. L is that of its table of gains after coasts, with lines between 0, 4,
10 and 30 periods without a sample, and ΔL that after none. They are steady from the first sample on, and the filter
knows no limit of the rotors, so it takes a saturated start for wind. A network that flies with it has to know these. N
is the latency in whole periods, rounded.

| part                                              | size | scale                |
|---------------------------------------------------|------|----------------------|
| z_N                                               | 28   | that of `deviations` |
| i                                                 | 8    | 0.005 m, 0.005       |
| −F z_N, F: the feedback of `lqg`                  | 4    | 1                    |
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.lqg import riccati
from quadpend_baselines.estimation.estimate import near_angle
from quadpend_baselines.estimation.kalman import GUST, MEASURED_COLUMNS, VARYING_STEPS
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.modelling.linear_model import (
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_STATE_SIZE,
    linearise_actions,
)
from quadpend_baselines.modelling.quantities import turn3
from quadpend_baselines.registry import controller
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.physics.vectors import Vec3, axpy, dot, load, norm, scale, store
from quadpend_gym.tasks.observation import LAB

NOISE = (0.0005, 0.001, 0.0006)  # standard deviations of motion capture: m, rad and rad
_MEASURED = tuple(MEASURED_COLUMNS.tolist())  # of z
_WIND = MODEL_STATE_SIZE + ACTION_SIZE
_SIZE = _WIND + MODEL_DISTURBANCE_SIZE
_RISE, _PSI, _BOB = 5, 8, _WIND + MODEL_BOB_FORCE.start
_VECTORS, _SPATIAL = (0, 3, _WIND, 12, 14, _BOB), 3  # x components of vectors of z; the first have a z component
_LEAST = 0.1  # of 1 + n_z, and m/s² of the apparent gravity
_COASTS = 0, 4, 10, 30  # control periods
_INNOVATION = 0.005  # scale
_LIMIT, _LIMIT_RATE = 0.05, 3.0  # of i: m and rad, and these a second since the last sample
_MOST = 100.0  # scales that bound z
MEASURED_SIZE = len(_MEASURED)
OBSERVED_SIZE = _SIZE + MEASURED_SIZE + ACTION_SIZE
# Memory: z; place of the reference and three derivatives; its yaw and the rate; at the last sample the heading and the
# share of lift; the time since it; n, and u, the oldest first
_PLACE, _YAW, _HEADING = _SIZE, _SIZE + 12, _SIZE + 14
_LIFT, _SINCE, _VERTICAL, _UNDER_WAY = _HEADING + 1, _HEADING + 2, _HEADING + 3, _HEADING + 6


class ConstantGain(NamedTuple):
    """The numbers of the filter."""

    A: Floats  # (28, 28)
    B: Floats  # (28, 4)
    gain: Floats  # L after a coast of each length of `_COASTS`, less that after the one before, (4, 28, 8)
    gust: Floats  # ΔL, (28, 8)
    ahead: Floats  # A^N, (28, 28)
    under_way: Floats  # A^{N−1} B … B, (28, 4 N)
    feedback: Floats  # −F, (4, 28)
    scales: Floats  # (28,)
    bounds: Floats  # of z; what is measured has none, (28,)
    gust_force: float  # N
    period: float  # s
    gravity: float  # m/s²

    @property
    def memory_size(self) -> int:
        """Length of the memory."""
        size: int = _UNDER_WAY + self.under_way.shape[1]
        return size


@lru_cache(maxsize=256)  # one for each length of a pole that is told
def constant_gain(simulation: Simulation, noise: tuple[float, float, float] = NOISE) -> ConstantGain:
    """Return the filter of a nominal vehicle for the known noise of `Loop`, which counts at least as `NOISE`."""
    model = linearise_actions(simulation)
    states = len(model.transition)
    place = np.r_[0:states, _WIND:_SIZE]
    A, B = np.zeros((_SIZE, _SIZE)), np.zeros((_SIZE, ACTION_SIZE))
    gain = np.zeros((2, len(_COASTS), _SIZE, MEASURED_SIZE))
    A[np.ix_(place, place)] = np.eye(len(place))
    A[np.ix_(place[:states], place[:states])], A[:states, _WIND:], B[:states] = (
        model.transition, model.disturbance, model.input,
    )  # fmt: skip
    position, euler, direction = map(max, noise, NOISE)
    law: Any = controller("lqg").designed_for(simulation, Loop(noise=(position, euler, direction), observation=LAB))
    table, kept = law.estimator.tables[0][VARYING_STEPS - 1 + np.array(_COASTS)], np.r_[0:MODEL_STATE_SIZE, _WIND:_SIZE]
    for k in range(table.shape[2] // MODEL_STATE_SIZE):
        gain[k][:, kept] = np.diff(table[:, :, MODEL_STATE_SIZE * k + np.array(_MEASURED)], axis=0, prepend=0.0)
    n = int(simulation.latency / simulation.period + 0.5)
    powers = [np.linalg.matrix_power(A, k) for k in range(n + 1)]
    feedback = np.zeros((ACTION_SIZE, _SIZE))
    feedback[:, place] = -riccati(law.gains, simulation)[0]
    under_way = np.hstack([np.zeros((_SIZE, 0)), *[powers[n - 1 - k] @ B for k in range(n)]])
    p = simulation.parameters
    scales = deviation_scales(p.hover_thrust)[ACTION_SIZE:][:_SIZE]
    bounds = _MOST * scales
    bounds[list(_MEASURED)] = np.inf
    limit = GUST * p.bob_mass * p.gravity
    return ConstantGain(
        A, B, gain[0], gain[1][0], powers[n], under_way, feedback, scales, bounds, limit, simulation.period, p.gravity
    )


@inlined
def apparent_vertical(acceleration: Vec3, sine: float, cosine: float, gravity: float) -> Vec3:
    """Return n in the axes of a heading, for an acceleration of the reference in the world (m/s²)."""
    a = turn3(acceleration, -sine, cosine)
    a = Vec3(a.x, a.y, a.z + gravity)
    return scale(1.0 / max(norm(a), _LEAST), a)


@inlined
def to_trajectory(v: Vec3, n: Vec3) -> Vec3:
    """Return a vector, from the axes of the heading, in those that are turned with the vertical to n."""
    along = (n.x * v.x + n.y * v.y) / max(1.0 + n.z, _LEAST)
    return Vec3(v.x - n.x * (along + v.z), v.y - n.y * (along + v.z), dot(n, v))


@inlined
def from_trajectory(v: Vec3, n: Vec3) -> Vec3:
    """Undo `to_trajectory`."""
    along = (n.x * v.x + n.y * v.y) / max(1.0 + n.z, _LEAST)
    return Vec3(v.x - n.x * (along - v.z), v.y - n.y * (along - v.z), n.z * v.z - n.x * v.x - n.y * v.y)


@inlined
def _product(matrix: Any, i: int, x: Any, row: int, first: int) -> float:
    total = 0.0
    for j in range(matrix.shape[1]):
        total += matrix[i, j] * x[row, first + j]
    return total


@compiled
def observe(
    numbers: ConstantGain, y: Floats, sample: Floats, reference: Floats, action: Floats, last: Floats, now: Floats,
    out: Floats,
) -> None:  # fmt: skip
    """Write the inputs and the next memory, equations (1) to (3).

    Args:
        numbers: The filter.
        y: Deviations in these axes, shape (n, 8).
        sample: Yaw (rad); time since the last sample (s), 0 with one; 0 in the first step of an episode, else 1; and
            the share c of the lift, shape (n, 4).
        reference: Its place and three derivatives, its yaw and the rate of it, shape (n, 14).
        action: u, shape (n, 4).
        last: The memory.
        now: The next memory.
        out: The inputs.
    """
    A, B, gain, gust, ahead, under_way, feedback, scales, bounds, gust_force, period, gravity = numbers
    waiting = under_way.shape[1]
    for row in range(out.shape[0]):
        taken, begun = select(sample[row, 1] > 0.0, 0.0, 1.0), sample[row, 2]
        for i in range(_SIZE):
            out[row, i] = _product(A, i, last, row, 0)
            for j in range(ACTION_SIZE):
                out[row, i] += B[i, j] * (last[row, _UNDER_WAY + j] if waiting > 0 else action[row, j])
        for i in range(waiting):
            later = _UNDER_WAY + ACTION_SIZE + i
            now[row, _UNDER_WAY + i] = (
                last[row, later] if i < waiting - ACTION_SIZE else action[row, i - waiting + ACTION_SIZE]
            )
        # From the axes of the last step to those of this one, after the jump of the reference
        yaw = select(taken > 0.5, sample[row, 0], last[row, _HEADING])
        now[row, _HEADING], now[row, _YAW], now[row, _YAW + 1] = yaw, reference[row, 12], reference[row, 13]
        sine, cosine = sincos(last[row, _HEADING])
        p, v, a = load(last.T, _PLACE, row), load(last.T, _PLACE + 3, row), load(last.T, _PLACE + 6, row)
        place, velocity = load(reference.T, 0, row), load(reference.T, 3, row)
        jerk, half = load(last.T, _PLACE + 9, row), 0.5 * period * period
        p = axpy(half * period / 3.0, jerk, axpy(half, a, axpy(period, v, p)))
        v = axpy(half, jerk, axpy(period, a, v))
        old = load(last.T, _VERTICAL, row)
        jump = to_trajectory(turn3(axpy(-1.0, p, place), -sine, cosine), old)
        change = to_trajectory(turn3(axpy(-1.0, v, velocity), -sine, cosine), old)
        out[row, _RISE] += period * gravity * last[row, _LIFT]
        now[row, _LIFT] = select(taken > 0.5, sample[row, 3], last[row, _LIFT])
        for i in range(3):
            out[row, i] -= jump[i]
            out[row, 3 + i] -= change[i]
        store(now.T, _PLACE, row, place)
        store(now.T, _PLACE + 3, row, velocity)
        store(now.T, _PLACE + 6, row, load(reference.T, 6, row))
        store(now.T, _PLACE + 9, row, load(reference.T, 9, row))
        out[row, _PSI] -= reference[row, 12] - last[row, _YAW] - period * last[row, _YAW + 1]
        sine, cosine = sincos(yaw)
        n = apparent_vertical(load(reference.T, 6, row), sine, cosine, gravity)
        store(now.T, _VERTICAL, row, n)
        sine, cosine = sincos(yaw - last[row, _HEADING])
        for k in range(len(_VECTORS)):
            i, is_spatial = _VECTORS[k], k < _SPATIAL
            vector = Vec3(out[row, i], out[row, i + 1], out[row, i + 2] if is_spatial else 0.0)
            vector = to_trajectory(turn3(from_trajectory(vector, old), -sine, cosine), n)
            out[row, i], out[row, i + 1] = vector.x, vector.y
            if is_spatial:
                out[row, i + 2] = vector.z
        # Correction
        limit = _LIMIT + _LIMIT_RATE * last[row, _SINCE]
        coast = last[row, _SINCE] / period
        now[row, _SINCE] = sample[row, 1]
        for k in range(MEASURED_SIZE):
            value = near_angle(y[row, k], out[row, _PSI]) if _MEASURED[k] == _PSI else y[row, k]
            error = min(max(value - out[row, _MEASURED[k]], -limit), limit)
            out[row, _SIZE + k] = select(begun > 0.5, select(taken > 0.5, error, 0.0), 0.0)
        pull = out[row, _BOB] * out[row, _BOB] + out[row, _BOB + 1] * out[row, _BOB + 1]
        share = min(pull / (gust_force * gust_force), 1.0)
        for i in range(_SIZE):
            now[row, i] = out[row, i] + share * _product(gust, i, out, row, _SIZE)
        for k in range(len(_COASTS)):
            shorter, longer = _COASTS[k - 1] if k > 0 else -1, _COASTS[k]
            after = min(max((coast - shorter) / (longer - shorter), 0.0), 1.0)
            for i in range(_SIZE):
                now[row, i] += after * _product(gain[k], i, out, row, _SIZE)
        for i in range(_SIZE):
            now[row, i] = min(max(select(begun > 0.5, now[row, i], 0.0), -bounds[i]), bounds[i])
        for k in range(MEASURED_SIZE):
            now[row, _MEASURED[k]] = select(begun > 0.5, now[row, _MEASURED[k]], y[row, k])
            out[row, _SIZE + k] /= _INNOVATION
        for i in range(_SIZE):
            out[row, i] = _product(ahead, i, now, row, 0) + _product(under_way, i, now, row, _UNDER_WAY)
        for i in range(ACTION_SIZE):
            out[row, OBSERVED_SIZE - ACTION_SIZE + i] = _product(feedback, i, out, row, 0)
        for i in range(_SIZE):
            out[row, i] /= scales[i]
