"""Integration in time of the paper's vehicle: the compiled loop that advances a batch of states by one control period.

One substep of length h uses the classical Runge–Kutta method (RK4) in coordinates in which most of the motion has an
exact solution; `quadpend_gym.physics.dynamics` has the equations:

    attitude         exact: a quadratic function of time, since τ is constant during a control period
    centre of mass   Ẍ depends on time only, so RK4 is Simpson's rule
    pendulum         RK4 for (r, ṙ), with w at the times t, t + h/2 and t + h

At the end of a substep r is normalised and ṙ is projected onto the plane perpendicular to r. Each substep computes the
thrust axis for its middle and its end, and takes that for its start from the previous substep.

The loop works on blocks of 64 sub-environments. It copies each block into buffers of shape (field, lane), with one lane
for each sub-environment, so that the compiler can turn every loop over lanes into vector instructions. A batch of one
sub-environment runs the same code and gives bit-identical results.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.dynamics import (
    centre_acceleration,
    centre_offset,
    direction_acceleration,
    euler_acceleration,
    load_physics,
    thrust_axis,
    unconstrained_acceleration,
)
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    BOB_FORCE,
    COMMAND_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
    EULER,
    EULER_RATE,
    FORCE,
    POSITION,
    STATE_SIZE,
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
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

BLOCK = 64  # sub-environments in a block
LOOP_EFFICIENCY = 0  # first of four rows of `loops`: thrust and torques that act, divided by the nominal ones
# In the (field, lane) buffers, the thrust axis follows the state.
THRUST_AXIS = STATE_SIZE
LANE_STATE_SIZE = STATE_SIZE + 3
DIVERGENCE_LIMIT = 1e6  # a state diverges when the sum of its absolute values reaches this


@inlined
def find_acting(issued: Any, ages: Any, substep: int, lanes: int, out: Any) -> None:
    """Write the actions that act in a substep into a (4, lane) buffer.

    Each loop is over lanes, so that the compiler can vectorise it.

    Args:
        issued: Actions of the last k control steps, the oldest first, in a (4 k, lane) buffer.
        ages: Control steps since the action that acts was issued, by substep and lane.
        substep: The substep.
        lanes: The number of lanes.
        out: The output.
    """
    newest = issued.shape[0] // ACTION_SIZE - 1
    for field in range(ACTION_SIZE):
        for lane in range(lanes):
            out[field, lane] = issued[ACTION_SIZE * newest + field, lane]
    for k in range(newest):
        for field in range(ACTION_SIZE):
            for lane in range(lanes):
                before = issued[ACTION_SIZE * (newest - 1 - k) + field, lane]
                out[field, lane] = select(ages[substep, lane] > k, before, out[field, lane])


@inlined
def commanded(action: Four, s: Four, efficiency: Four) -> Four:
    """Return thrust (N) and torques (N·m) of an action; s is `Simulation.command_scale`."""
    full = Four(s.a * efficiency.a, s.b * efficiency.b, s.c * efficiency.c, s.d * efficiency.d)
    return Four(full.a * (1.0 + action.a), full.b * action.b, full.c * action.c, full.d * action.d)


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
def gather(rows: Any, first: int, lanes: int, out: Any) -> None:
    """Copy rows `first` to `first + lanes` of a (row, field) array into a (field, lane) buffer."""
    for lane in range(lanes):
        for field in range(rows.shape[1]):
            out[field, lane] = rows[first + lane, field]


@inlined
def scatter(lanes_in: Any, first: int, lanes: int, out: Any) -> None:
    """Copy a (field, lane) buffer into rows `first` to `first + lanes` of a (row, field) array."""
    for lane in range(lanes):
        for field in range(out.shape[1]):
            out[first + lane, field] = lanes_in[field, lane]


@inlined
def add_mean(value: Four, share: float, lane: int, out: Any) -> None:
    """Move the mean in the four rows of `out` to a value by `share`; the mean of equal values is exact."""
    mean = load_four(out, 0, lane)
    gap = Four(value.a - mean.a, value.b - mean.b, value.c - mean.c, value.d - mean.d)
    a, b, c, d = mean.a + share * gap.a, mean.b + share * gap.b, mean.c + share * gap.c, mean.d + share * gap.d
    store_four(out, 0, lane, Four(a, b, c, d))


@inlined
def integrate_euler(
    state: Any,
    issued: Any,
    ages: Any,
    loops: Any,
    disturbance: Any,
    physics: Any,
    command_scale: Four,
    lanes: int,
    period: float,
    substeps: int,
    command: Any,
) -> None:
    """Advance one block by a control period, in (field, lane) buffers; `state` has `LANE_STATE_SIZE` fields.

    `issued` and `ages` are those of `find_acting`; `loops` begins with the efficiency. The mean of
    thrust (N) and torques (N·m) over the period is written into `command`.
    """
    acting = np.empty((ACTION_SIZE, state.shape[1]))
    for lane in range(lanes):
        store(state, THRUST_AXIS, lane, thrust_axis(load(state, EULER, lane)))
        store_four(command, 0, lane, Four(0.0, 0.0, 0.0, 0.0))
    for substep in range(substeps):
        find_acting(issued, ages, substep, lanes, acting)
        share = 1.0 / (substep + 1.0)
        for lane in range(lanes):
            wrench = commanded(load_four(acting, 0, lane), command_scale, load_four(loops, LOOP_EFFICIENCY, lane))
            _substep(state, wrench, disturbance, physics, lane, period / substeps)
            add_mean(wrench, share, lane, command)


@compiled
def advance(
    state: Floats, command: Floats, disturbance: Floats, parameters: Floats, period: float, substeps: int
) -> None:
    """Advance n states in place by one period (s), during which commands and disturbances are constant.

    States, commands and disturbances have the shapes (n, 18), (n, 4) and (n, 9), see `quadpend_gym.physics.state`;
    parameters have the shape (n, 9).
    """
    state_lanes, command_lanes = np.empty((LANE_STATE_SIZE, BLOCK)), np.empty((COMMAND_SIZE, BLOCK))
    disturbance_lanes, physics_lanes = np.empty((DISTURBANCE_SIZE, BLOCK)), np.empty((PARAMETERS_SIZE, BLOCK))
    for first in range(0, state.shape[0], BLOCK):
        lanes = min(BLOCK, state.shape[0] - first)
        gather(state, first, lanes, state_lanes)
        gather(command, first, lanes, command_lanes)
        gather(disturbance, first, lanes, disturbance_lanes)
        gather(parameters, first, lanes, physics_lanes)
        for lane in range(lanes):
            store(state_lanes, THRUST_AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
        for _ in range(substeps):
            for lane in range(lanes):
                wrench = load_four(command_lanes, 0, lane)
                _substep(state_lanes, wrench, disturbance_lanes, physics_lanes, lane, period / substeps)
        scatter(state_lanes, first, lanes, state)
