"""Random starts near the reference.

Flying the reference is, to first order in the tilt, with K the chain stiffness and g the gravity (the paper's flat
parametrisation (30)–(45), corrected):

    (1)  r ∥ F̈_d + g e₃,                ṙ = (I − r rᵀ) F_d⁽³⁾ / |F̈_d + g e₃|
    (2)  ζ = F_d − l r  horizontally,    z = z_d
    (3)  thrust axis  b = r − F_d⁽⁴⁾ / (g K)  horizontally, turned by ψ_d into θ and −φ, which themselves turn at ψ̇_d

To this a deviation is added, uniform in each component.
"""

from typing import Any, NamedTuple

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import START_STREAM, Keys, derive, uniform_between
from quadpend_gym.physics.dynamics import Physics, load_physics
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, VELOCITY
from quadpend_gym.physics.vectors import Vec3, add, axpy, dot, norm, scale, store
from quadpend_gym.tasks.references import ReferencePoint, reference_point


class StartRanges(NamedTuple):
    """`tasks.StartSettings` inside a kernel."""

    position: float
    velocity: float
    angle: float
    angle_rate: float
    direction: float
    direction_rate: float


@inlined
def _deviation(key: Any, index: int, size: float) -> Vec3:
    return Vec3(
        uniform_between(key, index, -size, size),
        uniform_between(key, index + 1, -size, size),
        uniform_between(key, index + 2, -size, size),
    )


@inlined
def _turn(vector: Vec3, yaw: float) -> tuple[float, float]:
    """Roll and pitch (or their rates) that lean the thrust axis horizontally by `vector` at a yaw angle."""
    sin_yaw, cos_yaw = sincos(yaw)
    return sin_yaw * vector.x - cos_yaw * vector.y, cos_yaw * vector.x + sin_yaw * vector.y


@inlined
def draw_start(
    key: Any, ranges: StartRanges, reference: ReferencePoint, physics: Physics, lanes: Any, lane: int
) -> None:
    """Draw a start near `reference` into column `lane` of an (18, n) buffer."""
    gravity = physics.gravity
    stiffness = (physics.quadrotor_mass + physics.bob_mass) * gravity / (physics.quadrotor_mass * physics.rod_length)
    lift = Vec3(reference.d2.x, reference.d2.y, reference.d2.z + gravity)
    lean = axpy(1.0 / norm(lift), lift, _deviation(key, 0, ranges.direction))
    r = scale(1.0 / norm(lean), lean)
    swing = axpy(1.0 / norm(lift), reference.d3, _deviation(key, 3, ranges.direction_rate))
    r_dot = axpy(-dot(r, swing), r, swing)
    lead = -1.0 / (gravity * stiffness)
    roll, pitch = _turn(axpy(lead, reference.d4, r), reference.yaw)
    roll_rate, pitch_rate = _turn(axpy(lead, reference.d5, r_dot), reference.yaw)
    yaw_rate = reference.yaw_rate
    turning = Vec3(roll_rate + yaw_rate * pitch, pitch_rate - yaw_rate * roll, yaw_rate)
    position = axpy(-physics.rod_length, r, reference.d0)
    velocity = axpy(-physics.rod_length, r_dot, reference.d1)
    store(
        lanes,
        POSITION,
        lane,
        add(Vec3(position.x, position.y, reference.d0.z), _deviation(key, 6, ranges.position)),
    )
    store(
        lanes,
        VELOCITY,
        lane,
        add(Vec3(velocity.x, velocity.y, reference.d1.z), _deviation(key, 9, ranges.velocity)),
    )
    store(lanes, EULER, lane, add(Vec3(roll, pitch, reference.yaw), _deviation(key, 12, ranges.angle)))
    store(
        lanes,
        EULER_RATE,
        lane,
        add(turning, _deviation(key, 15, ranges.angle_rate)),
    )
    store(lanes, DIRECTION, lane, r)
    store(lanes, DIRECTION_RATE, lane, r_dot)


@compiled
def draw_starts(
    rows: Integers,
    seeds: Keys,
    episodes: Integers,
    ranges: Floats,
    parameters: Floats,
    reference: Floats,
    state: Floats,
) -> None:
    """Draw a random start near the reference of each of the given rows.

    Args:
        rows: indices into the arrays below, shape (m,).
        seeds: root of each row's random streams, shape (n,).
        episodes: number of each row's episode, shape (n,).
        ranges: `tasks.flatten` of the task's start.
        parameters: shape (n, 9).
        reference: shape (n, 20).
        state: written, shape (n, 18).
    """
    bounds = StartRanges(ranges[0], ranges[1], ranges[2], ranges[3], ranges[4], ranges[5])
    for row in rows:
        key = derive(derive(seeds[row], episodes[row]), START_STREAM)
        point = reference_point(reference.T, row, 0.0)
        draw_start(key, bounds, point, load_physics(parameters.T, row), state.T, row)
