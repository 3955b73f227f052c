"""An extended Kalman filter with tabulated gains, as a memory of a network.

x are the state of `modelling.linear_model`, the thrusts of the rotors less those at hover, and the wind d. Place and
yaw are relative to the reference, velocities are those in the world, and rates are body rates. The axes are horizontal,
with x along the heading: the measured one, and without a new sample the predicted one. With f, the motion of the rigid
body over a control period,

    (1)  x⁻ = R (f(x, a_{k−1−N}) − j)     a: actions; j: motion of the reference; R: to the axes of this step
    (2)  x = x⁻ + (L + s ΔL) i,           i = y − C x⁻, limited; without a new sample i = 0
    (3)  x_N = f(… f(x, a_{k−N}) …, a_{k−1}), when the next action acts

N is the latency in whole periods, rounded. y are position, Euler angles and direction. f takes the substeps of the
simulation, with its rate loop and its rotors. In a substep the accelerations are constant: those of its start, with the
thrusts of its middle. This is of first order in its length, and errs by 1 to 3 % of a change at tilts of 45°. In f the
axes stay, as if the vehicle kept its heading, and propellers have no angular momentum. The masses are the nominal ones:
others appear as a vertical force.

L is that of `lqg`, with lines between its gains after 0, 4, 10 and 30 periods without a sample; to these the difference
of its gain in early corrections from the steady one is added, with lines between 0, 1, 2, 4, 8, 16 and 30 corrections.
What L corrects of the rates of the Euler angles is taken for body rates. s and ΔL = L_gust − L_calm, the steady one,
are those of equation (4) of `estimation.kalman`. In the first step x is the measurement, with the rates of the
reference's trajectory, the thrusts of hover and no wind.

Each component of i is limited to ±0.05 m, rad or 1; this limit grows by 3/s without a sample. A sample with a component
beyond the limit corrects x by the limited i, but limit and L go on as without a sample: they grow until the filter has
come near enough.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import near_angle
from quadpend_baselines.estimation.kalman import GUST, MEASURED_COLUMNS, VARYING_STEPS
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.modelling.linear_model import (
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_STATE_SIZE,
)
from quadpend_baselines.registry import controller
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import euler_rate, quaternion_from_euler, rotation_matrix, to_world
from quadpend_gym.physics.drag import drag_force, rotor_drag_force
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.rigid_body import Loads, Motion, RigidPhysics, Wrench, derivative, rigid_physics
from quadpend_gym.physics.rigid_kernel import command_rotors
from quadpend_gym.physics.rigid_settings import RigidSettings, pack_rigid, unpack_rigid
from quadpend_gym.physics.rotors import thrusts_after, wrench_of
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, centripetal, cross, load_four, scale
from quadpend_gym.tasks.observation import LAB

NOISE = (0.0005, 0.001, 0.0006)  # standard deviations of motion capture: m, rad and rad
MEASURED = tuple(MEASURED_COLUMNS.tolist())  # of x
THRUSTS, WIND = MODEL_STATE_SIZE, MODEL_STATE_SIZE + ACTION_SIZE
SIZE = WIND + MODEL_DISTURBANCE_SIZE
_PSI, _BOB = 8, WIND + MODEL_BOB_FORCE.start
_VECTORS = 0, 3, WIND, 12, 14, _BOB  # x components of vectors of x; the torque turns with the heading
_COASTS = 0, 4, 10, 30  # control periods
_EARLY = 0, 1, 2, 4, 8, 16, 30  # corrections
_LIMIT, _LIMIT_RATE = 0.05, 3.0  # of i: m, rad and 1, and these for each second without a sample before
_MOST, _TILT = 100.0, 1.2  # bounds of x: scales of `deviations`, and of roll, pitch and the pole, rad
_LEAST_SQUARE = 0.1  # of r_z
# Memory: x; place and yaw of the reference; heading of the axes; time since the last sample within the limit;
# corrections; and a, the oldest first
_PLACE, _YAW, HEADING, _COASTED, _AGE, _UNDER_WAY = SIZE, SIZE + 3, SIZE + 4, SIZE + 5, SIZE + 6, SIZE + 7


class ScheduledGain(NamedTuple):
    """The numbers of the filter."""

    gain: Floats  # L after a coast of each length of `_COASTS`, less that after the one before, (4, 28, 8)
    early: Floats  # L after as many corrections as in `_EARLY` but the last, less the steady one, (6, 28, 8)
    gust: Floats  # ΔL, zero without `gust_walk`, (28, 8)
    bounds: Floats  # of |x|; infinite for place and yaw, (28,)
    physics: Floats  # parameters, (9, 1)
    rigid: Floats  # packed `RigidSettings`
    gust_force: float  # on the bob from which on s = 1, N
    period: float  # s
    substeps: int
    delay: int  # N


def _delay(simulation: Simulation) -> int:
    return int(simulation.latency / simulation.period + 0.5)


def memory_size(simulation: Simulation) -> int:
    """Return the length of the memory of the filter."""
    return int(_UNDER_WAY + ACTION_SIZE * _delay(simulation))


@lru_cache(maxsize=256)  # one for each length of a pole that is told
def scheduled_gain(simulation: Simulation, noise: tuple[float, float, float] = NOISE) -> ScheduledGain:
    """Return the filter of a nominal vehicle for the known noise of `Loop`, which counts at least as `NOISE`."""
    if simulation.vehicle.attitude != "rigid":
        raise ValueError(f"a policy on the observation 'lab' flies rigid vehicles, not {simulation.vehicle.name}")
    position, euler, direction = map(max, noise, NOISE)
    law: Any = controller("lqg").designed_for(simulation, Loop(noise=(position, euler, direction), observation=LAB))
    table, measured, p = law.estimator.tables[0], np.array(MEASURED), simulation.parameters
    kept, late = np.r_[0:MODEL_STATE_SIZE, WIND:SIZE], VARYING_STEPS - 1
    gain, early = (np.zeros((len(ages), SIZE, len(MEASURED))) for ages in (_COASTS, _EARLY[:-1]))
    gust = np.zeros_like(gain[0])
    gain[:, kept] = np.diff(table[late + np.array(_COASTS)][:, :, measured], axis=0, prepend=0.0)
    early[:, kept] = table[np.array(_EARLY[:-1])][:, :, measured] - table[late][:, measured]
    if table.shape[2] > MODEL_STATE_SIZE:
        gust[kept] = table[late][:, MODEL_STATE_SIZE + measured]
    bounds = _MOST * deviation_scales(p.hover_thrust)[ACTION_SIZE:][:SIZE]
    bounds[0:3], bounds[6:8], bounds[_PSI], bounds[12:14] = np.inf, _TILT, np.inf, np.sin(_TILT)
    physics, force = p.as_array()[:, np.newaxis], GUST * p.bob_mass * p.gravity
    times = simulation.period, simulation.substeps, _delay(simulation)
    return ScheduledGain(gain, early, gust, bounds, physics, pack_rigid(simulation), force, *times)


@inlined
def height(x: float, y: float) -> float:
    """Return the vertical component of a direction that points upwards, at least 0.32."""
    return float(np.sqrt(max(1.0 - x * x - y * y, _LEAST_SQUARE)))


@inlined
def _accelerations(
    x: Any, thrusts: Four, p: Parameters, body: RigidPhysics, rigid: RigidSettings
) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Return the rates of velocity (m/s²), Euler angles (rad/s), body rate (rad/s²) and direction rate (1/s²)."""
    attitude, rate = quaternion_from_euler(Vec3(x[6], x[7], 0.0)), Vec3(x[9], x[10], x[11])
    rotation, air = rotation_matrix(attitude), Vec3(-x[3], -x[4], -x[5])
    up = height(x[12], x[13])
    r, r_dot = Vec3(x[12], x[13], up), Vec3(x[14], x[15], -(x[12] * x[14] + x[13] * x[15]) / up)
    by_rotors = rotor_drag_force(rigid.rotor_drag, rotation, air)
    force = add(Vec3(x[20], x[21], x[22]), add(by_rotors, drag_force(p.quadrotor_drag_area, air)))
    bob_force = add(Vec3(x[23], x[24], 0.0), drag_force(p.bob_drag_area, axpy(-p.rod_length, r_dot, air)))
    between = axpy(1.0 / p.quadrotor_mass, force, scale(-1.0 / p.bob_mass, bob_force))
    torque = axpy(rigid.drag_height, cross(rotation.z, by_rotors), Vec3(x[25], x[26], x[27]))
    v = wrench_of(thrusts, rigid.rotors)
    loads = Loads(force, bob_force, between, torque, 0.0, rigid.angular_drag)
    found = derivative(Motion(attitude, rate, r, r_dot), Wrench(v.a, Vec3(v.b, v.c, v.d)), loads, p, body)
    turning, swinging = found.motion.rate, found.motion.direction_rate
    pivot = to_world(rotation, add(cross(turning, rigid.pivot), centripetal(rate, rigid.pivot)))
    share = p.bob_mass / (p.quadrotor_mass + p.bob_mass)
    moving = axpy(-share, axpy(p.rod_length, swinging, pivot), found.centre)
    return moving, euler_rate(rotation, rate), turning, swinging


@inlined
def substep(x: Any, action: Four, h: float, p: Parameters, body: RigidPhysics, rigid: RigidSettings) -> None:
    """Advance x in place by a substep of the length h (s) under an action."""
    rotors, hover = rigid.rotors, rigid.rotors.hover
    thrusts = Four(hover.a + x[16], hover.b + x[17], hover.c + x[18], hover.d + x[19])
    wanted = command_rotors(action, thrusts, Vec3(x[9], x[10], x[11]), rigid)
    middle = thrusts_after(thrusts, wanted, rotors.rise.y, rotors.fall.y)
    after = thrusts_after(thrusts, wanted, rotors.rise.z, rotors.fall.z)
    moving, tilting, turning, swinging = _accelerations(x, middle, p, body, rigid)
    for i in range(3):
        x[i] += h * (x[3 + i] + 0.5 * h * moving[i])
        x[3 + i] += h * moving[i]
        x[6 + i] += h * (tilting[i] + 0.5 * h * turning[i])
        x[9 + i] += h * turning[i]
    for i in range(2):
        x[12 + i] += h * (x[14 + i] + 0.5 * h * swinging[i])
        x[14 + i] += h * swinging[i]
    for i in range(ACTION_SIZE):
        x[THRUSTS + i] = after[i] - hover[i]


@inlined
def _product(matrix: Any, i: int, x: Any, row: int) -> float:
    total = 0.0
    for j in range(matrix.shape[1]):
        total += matrix[i, j] * x[row, j]
    return total


@inlined
def _ramp(x: float, first: float, last: float) -> float:
    """Return the share of the way from `first` to `last`, within 0 and 1."""
    return min(max((x - first) / (last - first), 0.0), 1.0)


@inlined
def _axes_and_reference(x: Any, row: int, yaw: float, reference: Any, last: Any, now: Any) -> None:
    """Turn x to the axes of a heading, and subtract the motion of the reference; remember both."""
    sine, cosine = sincos(last[row, HEADING])
    dx, dy = reference[row, 0] - last[row, _PLACE], reference[row, 1] - last[row, _PLACE + 1]
    x[0] -= cosine * dx + sine * dy
    x[1] -= cosine * dy - sine * dx
    x[2] -= reference[row, 2] - last[row, _PLACE + 2]
    x[_PSI] -= reference[row, 3] - last[row, _YAW]
    sine, cosine = sincos(yaw - last[row, HEADING])
    for k in range(len(_VECTORS)):
        i = _VECTORS[k]
        a, b = x[i], x[i + 1]
        x[i], x[i + 1] = cosine * a + sine * b, cosine * b - sine * a
    for i in range(4):
        now[row, _PLACE + i] = reference[row, i]
    now[row, HEADING] = yaw


@compiled
def observe(
    numbers: ScheduledGain, y: Floats, sample: Floats, reference: Floats, action: Floats, last: Floats, now: Floats,
    later: Floats, innovation: Floats,
) -> None:  # fmt: skip
    """Write x_N, i and the next memory, equations (1) to (3).

    Args:
        numbers: The filter.
        y: The measured state as in x, in the axes of the measured heading, with the rates of the trajectory, with which
            the filter begins, shape (n, 16).
        sample: Measured yaw (rad); 1 with a new sample, else 0; 0 in the first step of an episode, else 1; 1 with a new
            sample that replaces what x has of it, else 0; shape (n, 4).
        reference: Place (m) and yaw (rad) of the reference, shape (n, 4).
        action: The last action, shape (n, 4).
        last: The memory, zeros at the start of an episode, shape (n, `memory_size`).
        now: The next memory.
        later: x_N, in the axes that `now` has, shape (n, 28).
        innovation: i, in the order of `MEASURED`, shape (n, 8).
    """
    rigid, p = unpack_rigid(numbers.rigid), load_physics(numbers.physics, 0)
    body, h = rigid_physics(p, rigid.correlation, rigid.pivot, rigid.shape), numbers.period / numbers.substeps
    x, waiting = np.empty(SIZE), ACTION_SIZE * numbers.delay
    for row in range(later.shape[0]):
        taken, begun, anew = sample[row, 1], sample[row, 2], sample[row, 3]
        for i in range(waiting):
            later_on = _UNDER_WAY + ACTION_SIZE + i
            now[row, _UNDER_WAY + i] = (
                last[row, later_on] if i < waiting - ACTION_SIZE else action[row, i - waiting + ACTION_SIZE]
            )
        for i in range(SIZE):
            x[i] = last[row, i]
        acting = load_four(last.T, _UNDER_WAY, row) if waiting > 0 else load_four(action.T, 0, row)
        for _ in range(numbers.substeps):
            substep(x, acting, h, p, body, rigid)
        yaw = select(taken > 0.5, sample[row, 0], x[_PSI] + last[row, _YAW])
        _axes_and_reference(x, row, yaw, reference, last, now)
        limit, coast = _LIMIT + _LIMIT_RATE * last[row, _COASTED], last[row, _COASTED] / numbers.period
        largest = 0.0
        for k in range(len(MEASURED)):
            i = MEASURED[k]
            value = near_angle(y[row, i], x[i]) if i == _PSI else y[row, i]
            largest, error = max(largest, abs(value - x[i])), min(max(value - x[i], -limit), limit)
            innovation[row, k] = select(begun * taken * (1.0 - anew) > 0.5, error, 0.0)
        share = min((x[_BOB] * x[_BOB] + x[_BOB + 1] * x[_BOB + 1]) / (numbers.gust_force * numbers.gust_force), 1.0)
        for i in range(SIZE):
            x[i] += share * _product(numbers.gust, i, innovation, row)
        for k in range(len(_COASTS)):
            weight = _ramp(coast, _COASTS[k - 1] if k > 0 else -1.0, _COASTS[k])
            for i in range(SIZE):
                x[i] += weight * _product(numbers.gain[k], i, innovation, row)
        age = last[row, _AGE]
        for k in range(len(numbers.early)):
            weight = 1.0 - _ramp(age, _EARLY[k], _EARLY[k + 1])
            weight *= _ramp(age, _EARLY[k - 1], _EARLY[k]) if k > 0 else 1.0
            for i in range(SIZE):
                x[i] += weight * _product(numbers.early[k], i, innovation, row)
        within = select(begun > 0.5, max(anew, select(largest < limit, taken, 0.0)), 1.0)
        now[row, _COASTED] = (1.0 - within) * (last[row, _COASTED] + numbers.period)
        now[row, _AGE] = select(begun > 0.5, min(age + taken, 1.0 * _EARLY[-1]), 0.0)
        for i in range(SIZE):
            first = y[row, i] if i < MODEL_STATE_SIZE else 0.0
            kept = select(anew > 0.5, first, x[i]) if i in MEASURED else x[i]
            x[i] = min(max(select(begun > 0.5, kept, first), -numbers.bounds[i]), numbers.bounds[i])
            now[row, i] = x[i]
        for k in range(numbers.delay):
            for _ in range(numbers.substeps):
                substep(x, load_four(now.T, _UNDER_WAY + ACTION_SIZE * k, row), h, p, body, rigid)
        for i in range(SIZE):
            later[row, i] = x[i]
