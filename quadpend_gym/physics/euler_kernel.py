"""Integration in time of the paper's vehicle: the compiled loop that advances a batch of states by one control period.

One substep of length h uses the classical Runge–Kutta method (RK4) in coordinates in which most of the motion has an
exact solution; `quadpend_gym.physics.dynamics` has the equations:

    attitude         exact: a quadratic function of time, since τ is constant during a control period
    centre of mass   Ẍ depends on time only, so RK4 is Simpson's rule
    pendulum         RK4 for (r, ṙ), with w at the times t, t + h/2 and t + h

At the end of a substep r is normalised and ṙ is projected onto the plane perpendicular to r. Each substep computes the
thrust axis for its middle and its end, and takes that for its start from the previous substep.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.dynamics import (
    centre_acceleration,
    centre_offset,
    direction_acceleration,
    euler_acceleration,
    load_physics,
    thrust_axis,
    unconstrained_acceleration,
)
from quadpend_gym.physics.plant_kernel import (
    LANE_STATE_SIZE,
    LOOP_EFFICIENCY,
    LOOP_SIZE,
    THRUST_AXIS,
    PlantKernel,
    acts_later,
    add_mean,
    advance_rows,
    find_acting,
)
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    BOB_FORCE,
    COMMAND_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    EULER,
    EULER_RATE,
    FORCE,
    POSITION,
    TORQUE,
    VELOCITY,
)
from quadpend_gym.physics.vectors import (
    Four,
    Vec3,
    add,
    axpy,
    dot,
    load,
    load_four,
    norm,
    scale,
    store,
    store_four,
)


class EulerSettings(NamedTuple):
    """The paper's vehicle inside compiled functions."""

    command_scale: Four  # see `Simulation.command_scale`
    has_drag: bool  # whether there is drag, as in air that can move


_ACTING = LANE_STATE_SIZE  # fields of thrust and torques in the buffer of a block
_unpack = unpacker(EulerSettings)
_UNIT = pack(EulerSettings(Four(1.0, 1.0, 1.0, 1.0), False))


@inlined
def _euler_at(euler: Vec3, rate: Vec3, acceleration: Vec3, time: float) -> Vec3:
    return axpy(time, axpy(0.5 * time, acceleration, rate), euler)


@inlined
def _substep(state: Any, command: Four, disturbance: Any, physics_lanes: Any, lane: int, h: float) -> None:
    """Advance column `lane` by h under thrust and torques.

    The suffixes 0, m and 1 mean the start, the middle and the end of the substep.
    """
    physics = load_physics(physics_lanes, lane)
    thrust = command.a
    quadrotor_force, bob_force = load(disturbance, FORCE, lane), load(disturbance, BOB_FORCE, lane)

    torque = Vec3(command.b, command.c, command.d)
    euler, euler_rate = load(state, EULER, lane), load(state, EULER_RATE, lane)
    euler_ddot = euler_acceleration(add(torque, load(disturbance, TORQUE, lane)), physics)
    euler_end = _euler_at(euler, euler_rate, euler_ddot, h)
    axis_end = thrust_axis(euler_end)
    force_0 = axpy(thrust, load(state, THRUST_AXIS, lane), quadrotor_force)
    force_m = axpy(thrust, thrust_axis(_euler_at(euler, euler_rate, euler_ddot, 0.5 * h)), quadrotor_force)
    force_1 = axpy(thrust, axis_end, quadrotor_force)

    w_0 = unconstrained_acceleration(force_0, bob_force, physics)
    w_m = unconstrained_acceleration(force_m, bob_force, physics)
    w_1 = unconstrained_acceleration(force_1, bob_force, physics)
    r, v1 = load(state, DIRECTION, lane), load(state, DIRECTION_RATE, lane)
    a1 = direction_acceleration(r, v1, w_0)
    v2 = axpy(0.5 * h, a1, v1)
    a2 = direction_acceleration(axpy(0.5 * h, v1, r), v2, w_m)
    v3 = axpy(0.5 * h, a2, v1)
    a3 = direction_acceleration(axpy(0.5 * h, v2, r), v3, w_m)
    v4 = axpy(h, a3, v1)
    a4 = direction_acceleration(axpy(h, v3, r), v4, w_1)
    r_end = axpy(h / 6.0, add(add(v1, v4), scale(2.0, add(v2, v3))), r)
    v_end = axpy(h / 6.0, add(add(a1, a4), scale(2.0, add(a2, a3))), v1)
    r_end = scale(1.0 / norm(r_end), r_end)
    v_end = axpy(-dot(r_end, v_end), r_end, v_end)

    offset = centre_offset(physics)
    centre = axpy(offset, r, load(state, POSITION, lane))
    centre_rate = axpy(offset, v1, load(state, VELOCITY, lane))
    centre_ddot_0 = centre_acceleration(force_0, bob_force, physics)
    centre_ddot_m = centre_acceleration(force_m, bob_force, physics)
    centre_ddot_1 = centre_acceleration(force_1, bob_force, physics)
    centre = axpy(h * h / 6.0, axpy(2.0, centre_ddot_m, centre_ddot_0), axpy(h, centre_rate, centre))
    centre_rate = axpy(h / 6.0, axpy(4.0, centre_ddot_m, add(centre_ddot_0, centre_ddot_1)), centre_rate)

    store(state, POSITION, lane, axpy(-offset, r_end, centre))
    store(state, VELOCITY, lane, axpy(-offset, v_end, centre_rate))
    store(state, EULER, lane, euler_end)
    store(state, EULER_RATE, lane, axpy(h, euler_ddot, euler_rate))
    store(state, DIRECTION, lane, r_end)
    store(state, DIRECTION_RATE, lane, v_end)
    store(state, THRUST_AXIS, lane, axis_end)


@inlined
def integrate_euler(
    state: Any,
    issued: Any,
    loops: Any,
    disturbance: Any,
    velocity: Any,
    hand: Any,
    physics: Any,
    settings: EulerSettings,
    lanes: int,
    period: float,
    substeps: int,
    command: Any,
) -> None:
    """Advance one block by a control period.

    Args:
        state: States, then the thrust axis and what a vehicle has besides, in a (field, lane) buffer as all arrays.
        issued: Actions of the last control steps, see `find_acting`.
        loops: The loops, see `plant_kernel`.
        disturbance: d_Q (N), d_B (N) and d_τ (N·m), to which the drag is added.
        velocity: Velocity of the air, m/s.
        hand: The hand, see `quadpend_gym.wind`; only rigid vehicles have one.
        physics: Physical parameters in the order of `Parameters`.
        settings: The vehicle.
        lanes: The number of lanes.
        period: The control period, s.
        substeps: The number of substeps.
        command: Output: the mean of thrust (N) and torques (N·m) over the period, shape (4, lane).
    """
    acting = state[_ACTING:]
    if settings.has_drag:
        for lane in range(lanes):
            add_drag(load(velocity, 0, lane), state, physics, lane, disturbance)
    for lane in range(lanes):
        store_euler_axis(state, lane)
        store_four(command, 0, lane, Four(0.0, 0.0, 0.0, 0.0))
    for substep in range(substeps):
        if substep == 0 or acts_later(loops, substep, lanes):
            find_acting(issued, loops, substep, lanes, acting)
            share = 1.0 / (substep + 1.0)
            for lane in range(lanes):
                _store_command(acting, settings, loops, lane, state, acting)
                add_mean(load_four(acting, 0, lane), share, lane, command)
        for lane in range(lanes):
            _substep(state, load_four(acting, 0, lane), disturbance, physics, lane, period / substeps)


@inlined
def store_euler_axis(state: Any, lane: int) -> None:
    """Write the thrust axis of Euler angles."""
    store(state, THRUST_AXIS, lane, thrust_axis(load(state, EULER, lane)))


@inlined
def _store_command(action: Any, settings: EulerSettings, loops: Any, lane: int, state: Any, command: Any) -> None:
    """Write thrust (N) and torques (N·m) of an action, see `Simulation.command_scale`."""
    a, s, share = load_four(action, 0, lane), settings.command_scale, load_four(loops, LOOP_EFFICIENCY, lane)
    thrust = s.a * share.a * (1.0 + a.a)
    store_four(command, 0, lane, Four(thrust, s.b * share.b * a.b, s.c * share.c * a.c, s.d * share.d * a.d))


EULER_KERNEL = PlantKernel(
    0, _ACTING + ACTION_SIZE, integrate_euler, store_euler_axis, store_euler_axis, _store_command
)


@compiled
def advance_euler(
    state: Floats,
    memory: Floats,
    action: Floats,
    loops: Floats,
    disturbance: Floats,
    parameters: Floats,
    packed: Floats,
    period: float,
    substeps: int,
) -> None:
    """Advance n states in place by one period, see `plant_kernel.advance_rows`; `packed` is an `EulerSettings`."""
    settings = _unpack(packed)
    advance_rows(EULER_KERNEL, state, memory, action, loops, disturbance, parameters, settings, period, substeps)


def advance(
    state: Floats, command: Floats, disturbance: Floats, parameters: Floats, period: float, substeps: int
) -> None:
    """Advance n states in place by one period (s), during which commands and disturbances are constant.

    States, commands and disturbances have the shapes (n, 18), (n, 4) and (n, 9), see `quadpend_gym.physics.state`;
    parameters have the shape (n, 9).
    """
    loops, rows = np.zeros((LOOP_SIZE + substeps, len(state))), len(state)
    loops[:COMMAND_SIZE] = command.T  # as the efficiency of unit commands
    action = np.tile([0.0, 1.0, 1.0, 1.0], (rows, 1))
    arrays = state, np.empty((rows, 0)), action, loops, disturbance, parameters
    advance_euler(*arrays, _UNIT, period, substeps)
