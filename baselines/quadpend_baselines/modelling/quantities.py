"""State, disturbance and reference of one vehicle inside compiled functions, as named tuples of vectors.

The layouts in arrays are those of `quadpend_gym.physics.state`; `lanes` are (field, row) arrays. Positions and
velocities of controllers are relative to the reference. The z component of a horizontal vector has no meaning.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import (
    BOB_FORCE,
    DIRECTION,
    DIRECTION_RATE,
    EULER,
    EULER_RATE,
    FORCE,
    POSITION,
    TORQUE,
    VELOCITY,
)
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, load, store


class VehicleState(NamedTuple):
    """The six vectors of a state, see `quadpend_gym.physics.state`."""

    position: Vec3
    velocity: Vec3
    euler: Vec3
    euler_rate: Vec3
    direction: Vec3
    direction_rate: Vec3


class Forces(NamedTuple):
    """A disturbance: force on the quadrotor and on the bob, N, and torque, N·m."""

    force: Vec3
    bob_force: Vec3
    torque: Vec3


class Derivatives(NamedTuple):
    """The derivatives of order 2 to 6 of the reference (F_x, F_y, z), (ψ, ψ̇, ψ̈) of the yaw, and what makes drag.

    Drag is (c, c_z, k_Q, k_B) of `trajectory_drag`, N·s/m and N·s²/m². Without the velocity of the reference (order 1),
    both are 0, and drag is a part of the disturbance.
    """

    d2: Vec3
    d3: Vec3
    d4: Vec3
    d5: Vec3
    d6: Vec3
    yaw: Vec3
    d1: Vec3
    drag: Four


@inlined
def load_state(lanes: Any, first: int, lane: int) -> VehicleState:
    """Return the state in the 18 fields from `first`."""
    return VehicleState(
        load(lanes, first + POSITION, lane),
        load(lanes, first + VELOCITY, lane),
        load(lanes, first + EULER, lane),
        load(lanes, first + EULER_RATE, lane),
        load(lanes, first + DIRECTION, lane),
        load(lanes, first + DIRECTION_RATE, lane),
    )


@inlined
def store_vectors(lanes: Any, first: int, lane: int, vectors: Any) -> None:
    """Write a state, a disturbance or a reference into the fields from `first`."""
    for i in range(len(vectors)):
        store(lanes, first + 3 * i, lane, vectors[i])


@inlined
def load_forces(lanes: Any, first: int, lane: int) -> Forces:
    """Return the disturbance in the nine fields from `first`."""
    return Forces(
        load(lanes, first + FORCE, lane), load(lanes, first + BOB_FORCE, lane), load(lanes, first + TORQUE, lane)
    )


@inlined
def load_reference(lanes: Any, first: int, lane: int) -> Derivatives:
    """Return the reference in the 18 fields from `first`: its derivatives by order, and the yaw; without drag."""
    return Derivatives(
        load(lanes, first, lane),
        load(lanes, first + 3, lane),
        load(lanes, first + 6, lane),
        load(lanes, first + 9, lane),
        load(lanes, first + 12, lane),
        load(lanes, first + 15, lane),
        Vec3(0.0, 0.0, 0.0),
        Four(0.0, 0.0, 0.0, 0.0),
    )


@inlined
def calm() -> Forces:
    """Return no disturbance."""
    none = Vec3(0.0, 0.0, 0.0)
    return Forces(none, none, none)


@inlined
def combine(factor: float, a: VehicleState, b: VehicleState) -> VehicleState:
    """Return factor · a + b."""
    return VehicleState(
        axpy(factor, a.position, b.position),
        axpy(factor, a.velocity, b.velocity),
        axpy(factor, a.euler, b.euler),
        axpy(factor, a.euler_rate, b.euler_rate),
        axpy(factor, a.direction, b.direction),
        axpy(factor, a.direction_rate, b.direction_rate),
    )


@inlined
def choose(condition: bool, chosen: VehicleState, other: VehicleState) -> VehicleState:
    """Return one of two states."""
    c = condition
    return VehicleState(
        _choose(c, chosen.position, other.position),
        _choose(c, chosen.velocity, other.velocity),
        _choose(c, chosen.euler, other.euler),
        _choose(c, chosen.euler_rate, other.euler_rate),
        _choose(c, chosen.direction, other.direction),
        _choose(c, chosen.direction_rate, other.direction_rate),
    )


@inlined
def _choose(condition: bool, a: Vec3, b: Vec3) -> Vec3:
    return Vec3(select(condition, a.x, b.x), select(condition, a.y, b.y), select(condition, a.z, b.z))


@inlined
def minus(a: Vec3, b: Vec3) -> Vec3:
    """Return a − b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inlined
def divide(a: Vec3, number: float) -> Vec3:
    """Return a / number."""
    return Vec3(a.x / number, a.y / number, a.z / number)


@inlined
def turn3(v: Vec3, sine: float, cosine: float) -> Vec3:
    """Return v, rotated about the vertical."""
    return Vec3(cosine * v.x - sine * v.y, sine * v.x + cosine * v.y, v.z)


@inlined
def limit_length(v: Vec3, limit: float) -> Vec3:
    """Return a vector whose horizontal part is scaled down if it is longer than `limit`."""
    share = limit / max(np.sqrt(v.x * v.x + v.y * v.y), limit)
    return Vec3(share * v.x, share * v.y, v.z)


@inlined
def bob_offset(state: VehicleState, length: float) -> tuple[Vec3, Vec3]:
    """Return the tracking error ζ + l r_xy of a state relative to the reference (m), and its rate (m/s)."""
    r, r_dot = state.direction, state.direction_rate
    arm, arm_rate = Vec3(length * r.x, length * r.y, 0.0), Vec3(length * r_dot.x, length * r_dot.y, 0.0)
    return add(state.position, arm), add(state.velocity, arm_rate)


@inlined
def with_rates(state: VehicleState, rates: VehicleState) -> VehicleState:
    """Return positions and angles of one state with the rates of another one."""
    return VehicleState(
        state.position, rates.velocity, state.euler, rates.euler_rate, state.direction, rates.direction_rate
    )
