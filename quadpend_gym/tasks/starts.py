"""Random starts near the reference.

To first order in the tilt, a state that tracks the reference exactly is, with the gravity g and K = (M + m_c) g / (M l)
(the paper's flat parametrisation (30)–(45), corrected):

    (1)  r ∥ F̈_d + c F_d⁽⁴⁾ + g e₃,     ṙ = (I − r rᵀ) (F_d⁽³⁾ + c F_d⁽⁵⁾) / |F̈_d + c F_d⁽⁴⁾ + g e₃|
    (2)  ζ = F_d − l r  horizontally,    z = z_d
    (3)  R e₃ = r − (1 + μ) F_d⁽⁴⁾ / (g K)  horizontally; rotated by −ψ_d this is (θ, −φ), whose rates include those due
         to ψ̇_d

with c = μ = 0 for a pole without inertia on a pivot in the body's centre of mass. A pole with the inertia J moves like
a point mass m' = m_c l/λ at λ = l + J/(m_c l) from the pivot, with the rest of its mass in the pivot; λ and
M' = M + m_c − m' take the place of l and M in K. The pivot is at the height p above the centre of mass. Then

    (4)  c = (λ − l + m_c p/(M + m_c)) / g + μ/K,    μ = M p/(M' λ)

in the horizontal components, up to derivatives of order 5. `quadpend_baselines.modelling.equivalent` derives this.

These equations also hold for a hanging pendulum, with −r and −l in place of r and l.

A start is this state plus a random deviation, which is uniform in each component. `StartSettings.pendulum_angle` then
turns r.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import unpacker
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import START_STREAM, Keys, derive, uniform_between
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, VELOCITY
from quadpend_gym.physics.vectors import Vec3, add, axpy, cross, dot, norm, scale, store
from quadpend_gym.tasks.references import ReferencePoint, load_point
from quadpend_gym.tasks.trajectories import reference_at
from quadpend_gym.vehicles import Parameters, Simulation


@settings
class StartSettings:
    """Largest deviation of a random start, in each component, from the state that tracks the reference exactly."""

    position: Annotated[float, Range(0.0, 1000.0, "m")] = 0.1  # largest deviation of the quadrotor's position
    velocity: Annotated[float, Range(0.0, 1000.0, "m/s")] = 0.05  # largest deviation of the quadrotor's velocity
    angle: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.03  # largest deviation of roll, pitch and yaw
    # largest deviation of the rates of roll, pitch and yaw
    angle_rate: Annotated[float, Range(0.0, 1000.0, "rad/s")] = 0.05
    # largest deviation of the pole's direction r, before r is normalised
    direction: Annotated[float, Range(0.0, 0.9)] = 0.03
    # largest deviation of ṙ, before its projection onto the plane perpendicular to r
    direction_rate: Annotated[float, Range(0.0, 1000.0, "1/s")] = 0.05
    # additional angle of the pole to a random side, uniform by the area on the sphere
    pendulum_angle: Annotated[Interval, Range(0.0, np.pi, "rad")] = (0.0, 0.0)


_unpack = unpacker(StartSettings)


class StartPole(NamedTuple):
    """The numbers of a pole and its pivot that `Parameters` does not have, and its side, inside compiled functions."""

    shape: float  # J/(m_c l²)
    pivot_height: float  # p, m
    side: float  # 1: upright, −1: hanging


def start_pole(simulation: Simulation, side: float) -> Floats:
    """Return the values of `StartPole`, shape (3,); the first two are zero for the paper's vehicle."""
    vehicle, p = simulation.vehicle, simulation.parameters
    return np.array([vehicle.pole.inertia / (p.bob_mass * p.rod_length**2), vehicle.pivot[2], side])


@inlined
def _deviation(key: Any, index: int, size: float) -> Vec3:
    return Vec3(
        uniform_between(key, index, -size, size),
        uniform_between(key, index + 1, -size, size),
        uniform_between(key, index + 2, -size, size),
    )


@inlined
def _roll_and_pitch(axis: Vec3, yaw: float) -> tuple[float, float]:
    """Return roll and pitch of a thrust axis to first order; given the rate of the axis, return their rates."""
    sin_yaw, cos_yaw = sincos(yaw)
    return sin_yaw * axis.x - cos_yaw * axis.y, cos_yaw * axis.x + sin_yaw * axis.y


@inlined
def _turned(key: Any, index: int, ranges: StartSettings, r: Vec3) -> Vec3:
    """Return r turned to a random side by a random angle, whose cosine is uniform."""
    (_, lowest), (_, highest) = sincos(ranges.pendulum_angle[1]), sincos(ranges.pendulum_angle[0])
    cosine = uniform_between(key, index, lowest, highest)
    sin_side, cos_side = sincos(uniform_between(key, index + 1, -np.pi, np.pi))
    axis = select(abs(r.x) < 0.8, 1.0, 0.0)
    along = cross(r, Vec3(axis, 1.0 - axis, 0.0))
    along = scale(1.0 / norm(along), along)
    to_side = axpy(cos_side, along, scale(sin_side, cross(r, along)))
    turned = axpy(cosine, r, scale(np.sqrt(max(1.0 - cosine * cosine, 0.0)), to_side))
    return scale(1.0 / norm(turned), turned)


@inlined
def _horizontally(a: float, x: Vec3, y: Vec3) -> Vec3:
    """Return a x + y in the horizontal components, and y in the vertical one."""
    return Vec3(a * x.x + y.x, a * x.y + y.y, y.z)


@inlined
def draw_start(
    key: Any,
    ranges: StartSettings,
    pole: StartPole,
    reference: ReferencePoint,
    physics: Parameters,
    lanes: Any,
    lane: int,
) -> None:
    """Draw a start near `reference` into column `lane` of an (18, n) buffer."""
    gravity, total_mass = physics.gravity, physics.quadrotor_mass + physics.bob_mass
    rod_length = pole.side * physics.rod_length
    length = rod_length * (1.0 + pole.shape)
    carried_mass = physics.quadrotor_mass + physics.bob_mass * pole.shape / (1.0 + pole.shape)
    stiffness = total_mass * gravity / (carried_mass * length)
    pivot_ratio = physics.quadrotor_mass * pole.pivot_height / (carried_mass * length)
    reach = rod_length * pole.shape + physics.bob_mass / total_mass * pole.pivot_height
    per_fourth = reach / gravity + pivot_ratio / stiffness
    lift = _horizontally(per_fourth, reference.d4, Vec3(reference.d2.x, reference.d2.y, reference.d2.z + gravity))
    per_lift = 1.0 / norm(lift)
    along_r = axpy(per_lift, lift, _deviation(key, 0, ranges.direction))
    r = scale(1.0 / norm(along_r), along_r)
    lift_rate = _horizontally(per_fourth, reference.d5, reference.d3)
    rate = axpy(per_lift, lift_rate, _deviation(key, 3, ranges.direction_rate))
    r_dot = axpy(-dot(r, rate), r, rate)
    per_snap = -(1.0 + pivot_ratio) / (gravity * stiffness)
    roll, pitch = _roll_and_pitch(axpy(per_snap, reference.d4, r), reference.yaw)
    roll_rate, pitch_rate = _roll_and_pitch(axpy(per_snap, reference.d5, r_dot), reference.yaw)
    yaw_rate = reference.yaw_rate
    euler = Vec3(roll, pitch, reference.yaw)
    euler_rate = Vec3(roll_rate + yaw_rate * pitch, pitch_rate - yaw_rate * roll, yaw_rate)
    position = axpy(-rod_length, r, reference.d0)
    position = Vec3(position.x, position.y, reference.d0.z)
    velocity = axpy(-rod_length, r_dot, reference.d1)
    velocity = Vec3(velocity.x, velocity.y, reference.d1.z)
    store(lanes, POSITION, lane, add(position, _deviation(key, 6, ranges.position)))
    store(lanes, VELOCITY, lane, add(velocity, _deviation(key, 9, ranges.velocity)))
    store(lanes, EULER, lane, add(euler, _deviation(key, 12, ranges.angle)))
    store(lanes, EULER_RATE, lane, add(euler_rate, _deviation(key, 15, ranges.angle_rate)))
    r, r_dot = scale(pole.side, r), scale(pole.side, r_dot)
    if ranges.pendulum_angle[1] > 0.0:
        r = _turned(key, 18, ranges, r)
        r_dot = axpy(-dot(r, r_dot), r, r_dot)
    store(lanes, DIRECTION, lane, r)
    store(lanes, DIRECTION_RATE, lane, r_dot)


@compiled
def draw_starts(
    rows: Integers,
    seeds: Keys,
    episodes: Integers,
    ranges: Floats,
    pole: Floats,
    parameters: Floats,
    reference: Floats,
    state: Floats,
    points: Floats,
    first: Integers,
) -> None:
    """Draw random starts near the references for the sub-environments `rows` into the states of all, shape (n, 18).

    The other arrays are also those of all: seeds (keys of random streams), numbers of episodes, parameters, shape
    (n, 9), references, shape (n, 20), and `TrajectoryTable.first`; but `points` are `TrajectoryTable.points` of `rows`.
    `ranges` is a packed `StartSettings`, `pole` a `StartPole`.
    """
    bounds, geometry = _unpack(ranges), StartPole(pole[0], pole[1], pole[2])
    for i in range(rows.shape[0]):
        row = rows[i]
        key = derive(derive(seeds[row], episodes[row]), START_STREAM)
        point = reference_at(reference.T, row, 0.0) if first[row] < 0 else load_point(points, i)
        draw_start(key, bounds, geometry, point, load_physics(parameters.T, row), state.T, row)
