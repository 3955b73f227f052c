"""Integration in time of rigid vehicles: the loop that advances a batch of states by one control period.

A substep first lets the on-board electronics convert the action to commanded rotor thrusts
(`quadpend_gym.physics.rotors`). It then integrates attitude, body rate, direction and direction rate with the classical
Runge–Kutta method (RK4) under the lagging thrusts, whose exact values at the start, the middle and the end of the
substep are known. The centre of mass of both bodies follows from the same stages, with Simpson's rule: the force at the
pivot cancels exactly, and what remains is the error of this rule over the lagging thrust and the turning attitude.
`quadpend_gym.physics.rigid_body` has the equations. At the end of a substep q and r are normalised, and ṙ is projected
onto the plane perpendicular to r.

The state has the 18 numbers of every vehicle, in which the Euler angles and their rates are outputs, and 11 more:

| symbol | name          | fields | unit  | frame                                                             |
|--------|---------------|--------|-------|-------------------------------------------------------------------|
| q      | QUATERNION    | 0–3    | 1     | body to world, order w, x, y, z                                   |
| ω      | BODY_RATE     | 4–6    | rad/s | body                                                              |
| f      | ROTOR_THRUST  | 7–10   | N     | thrusts of the rotors; thrust and torques (N, N·m) without rotors |

Drag acts always, with the air at rest if there is no wind: the quadratic drag of `quadpend_gym.physics.drag`, constant
during a control period, the drag of the rotors, linear in the velocity relative to the air and constant during a
substep, which acts at a height above the centre of mass, and the torque against the body rate.

A hand may pull at the pole's upper end (`quadpend_gym.wind.hand`). Its force is constant during a substep: that in the
middle, at the position and velocity that the equations of motion predict from the start with the force of the start.
This is of second order in the length of a substep.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import (
    Quaternion,
    Rotation,
    body_rate,
    euler_from_rotation,
    euler_rate,
    normalised,
    quaternion_from_euler,
    rotation_matrix,
    to_world,
)
from quadpend_gym.physics.drag import add_drag, rotor_drag_force
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.plant_kernel import (
    LANE_STATE_SIZE,
    THRUST_AXIS,
    PlantKernel,
    acts_later,
    add_mean,
    advance_rows,
    find_acting,
)
from quadpend_gym.physics.rigid_body import (
    LANE_BODY_SIZE,
    Loads,
    Motion,
    RigidPhysics,
    Wrench,
    centre_from_body,
    centre_rate_from_body,
    derivative,
    load_body,
    moved,
    rigid_physics,
    store_body,
)
from quadpend_gym.physics.rigid_settings import RigidSettings, make_rigid_settings, unpack_rigid, with_loop
from quadpend_gym.physics.rotors import (
    BODY_RATES,
    ROTOR_THRUSTS,
    allocate,
    clip4,
    propeller_momentum,
    rate_loop,
    thrusts_after,
    thrusts_from_hover,
    wrench_of,
)
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    BOB_FORCE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
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
    cross,
    dot,
    load,
    load_four,
    norm,
    scale,
    store,
    store_four,
)
from quadpend_gym.vehicles import Parameters, Simulation

QUATERNION, BODY_RATE, ROTOR_THRUST, RIGID_SIZE = 0, 4, 7, 11
# In the (field, lane) buffers, the rigid part of the state follows the thrust axis, and then come the action that acts,
# what a substep commands (rotor thrusts, drag of the rotors, momentum of the propellers), constants of the body, and,
# with a hand, the disturbance of a substep and its mean.
RIGID = LANE_STATE_SIZE
_QUATERNION, _BODY_RATE, _ROTOR_THRUST = RIGID + QUATERNION, RIGID + BODY_RATE, RIGID + ROTOR_THRUST
_ACTING, _WANTED, _ROTOR_DRAG, _MOMENTUM, _BODY, _LOADS, _MEAN, RIGID_LANE_SIZE = accumulate(
    (RIGID + RIGID_SIZE, ACTION_SIZE, 4, 3, 1, LANE_BODY_SIZE, DISTURBANCE_SIZE, DISTURBANCE_SIZE)
)


@inlined
def _load_quaternion(state: Any, lane: int) -> Quaternion:
    q = load_four(state, _QUATERNION, lane)
    return Quaternion(q.a, q.b, q.c, q.d)


@inlined
def command_rotors(action: Four, thrusts: Four, rate: Vec3, rigid: RigidSettings) -> Four:
    """Return the rotor thrusts (N) that an action commands; `thrusts` are the present ones (N), `rate` is ω (rad/s)."""
    rotors, scales = rigid.rotors, rigid.command_scale
    thrust = scales.a * (1.0 + action.a)
    torque, trim = Vec3(scales.b * action.b, scales.c * action.c, scales.d * action.d), rigid.trim
    if rigid.interface == BODY_RATES:
        present = wrench_of(thrusts, rotors)
        torque = rate_loop(rate, torque, axpy(-1.0, trim, Vec3(present.b, present.c, present.d)), rigid.loop)
    wrench = Four(thrust, torque.x + trim.x, torque.y + trim.y, torque.z + trim.z)
    if rotors.has_rotors == 0.0:
        return clip4(wrench, rotors.lowest, rotors.highest)
    return thrusts_from_hover(action, rotors) if rigid.interface == ROTOR_THRUSTS else allocate(wrench, rotors)


@inlined
def _prepare(state: Any, action: Four, velocity: Any, rigid: RigidSettings, lane: int) -> None:
    """Write the commanded rotor thrusts and the drag of the rotors for a substep."""
    thrusts, rate = load_four(state, _ROTOR_THRUST, lane), load(state, _BODY_RATE, lane)
    store_four(state, _WANTED, lane, command_rotors(action, thrusts, rate, rigid))
    rotation = rotation_matrix(_load_quaternion(state, lane))
    relative = axpy(-1.0, load(state, VELOCITY, lane), load(velocity, 0, lane))
    store(state, _ROTOR_DRAG, lane, rotor_drag_force(rigid.rotor_drag, rotation, relative))


@inlined
def _wrench(thrusts: Four, rigid: RigidSettings) -> Wrench:
    v = wrench_of(thrusts, rigid.rotors)
    return Wrench(v.a, Vec3(v.b, v.c, v.d))


@inlined
def _motion(state: Any, lane: int) -> Motion:
    return Motion(
        _load_quaternion(state, lane),
        load(state, _BODY_RATE, lane),
        load(state, DIRECTION, lane),
        load(state, DIRECTION_RATE, lane),
    )


@inlined
def _loads(
    state: Any, disturbance: Any, rotation: Rotation, physics: Parameters, rigid: RigidSettings, lane: int
) -> Loads:
    drag = load(state, _ROTOR_DRAG, lane)
    force = add(load(disturbance, FORCE, lane), drag)
    bob_force = load(disturbance, BOB_FORCE, lane)
    relative = axpy(1.0 / physics.quadrotor_mass, force, scale(-1.0 / physics.bob_mass, bob_force))
    torque = axpy(rigid.drag_height, cross(rotation.z, drag), load(disturbance, TORQUE, lane))
    return Loads(force, bob_force, relative, torque, state[_MOMENTUM, lane], rigid.angular_drag)


@inlined
def _pull(
    hand: Any,
    disturbance: Any,
    position: Vec3,
    velocity: Vec3,
    motion: Motion,
    physics: Parameters,
    rigid: RigidSettings,
    lane: int,
    loads: Any,
) -> None:
    """Write the disturbance with the force of the hand, for a position (m) and velocity (m/s) of the body."""
    rotation, length = rotation_matrix(motion.attitude), rigid.reach * physics.rod_length
    arm, swing = to_world(rotation, rigid.pivot), to_world(rotation, cross(motion.rate, rigid.pivot))
    end = axpy(length, motion.direction, add(position, arm))
    end_rate = axpy(length, motion.direction_rate, add(velocity, swing))
    stiffness, damping = hand[2, lane], hand[3, lane]
    x = hand[0, lane] - stiffness * end.x - damping * end_rate.x
    y = hand[1, lane] - stiffness * end.y - damping * end_rate.y
    at_pivot = scale(1.0 - rigid.reach, Vec3(x, y, 0.0))
    store(loads, FORCE, lane, add(load(disturbance, FORCE, lane), at_pivot))
    store(loads, BOB_FORCE, lane, axpy(rigid.reach, Vec3(x, y, 0.0), load(disturbance, BOB_FORCE, lane)))
    store(loads, TORQUE, lane, add(load(disturbance, TORQUE, lane), cross(arm, at_pivot)))


@inlined
def _hold_lane(
    state: Any,
    hand: Any,
    disturbance: Any,
    physics: Parameters,
    body: RigidPhysics,
    rigid: RigidSettings,
    lane: int,
    h: float,
    loads: Any,
) -> None:
    """Write the disturbance with the force that the hand has in the middle of a substep of length h."""
    motion, position, velocity = _motion(state, lane), load(state, POSITION, lane), load(state, VELOCITY, lane)
    _pull(hand, disturbance, position, velocity, motion, physics, rigid, lane, loads)
    start, wanted, rotors = load_four(state, _ROTOR_THRUST, lane), load_four(state, _WANTED, lane), rigid.rotors
    wrench = _wrench(thrusts_after(start, wanted, rotors.rise.x, rotors.fall.x), rigid)
    before = rotation_matrix(motion.attitude)
    rate = derivative(motion, wrench, _loads(state, loads, before, physics, rigid, lane), physics, body)
    middle = moved(0.5 * h, rate.motion, motion)
    rotation = rotation_matrix(middle.attitude)
    centre = add(position, centre_from_body(before, motion.direction, physics, body))
    centre_rate = add(velocity, centre_rate_from_body(before, motion.rate, motion.direction_rate, physics, body))
    offset = centre_from_body(rotation, middle.direction, physics, body)
    offset_rate = centre_rate_from_body(rotation, middle.rate, middle.direction_rate, physics, body)
    position = axpy(-1.0, offset, axpy(0.5 * h, centre_rate, centre))
    velocity = axpy(-1.0, offset_rate, axpy(0.5 * h, rate.centre, centre_rate))
    _pull(hand, disturbance, position, velocity, middle, physics, rigid, lane, loads)


@inlined
def _hold(
    state: Any,
    hand: Any,
    disturbance: Any,
    physics: Any,
    rigid: RigidSettings,
    loops: Any,
    lanes: int,
    h: float,
    substep: int,
    substeps: int,
) -> Any:
    """Return the disturbance of a substep with the force of the hand; replace it by its mean in the last substep."""
    loads, mean, share = state[_LOADS:_MEAN], state[_MEAN:], 1.0 / (substep + 1.0)
    for lane in range(lanes):
        parameters = load_physics(physics, lane)
        body = load_body(state, _BODY, lane, rigid.pivot, rigid.shape)
        _hold_lane(state, hand, disturbance, parameters, body, with_loop(rigid, loops, lane), lane, h, loads)
    for field in range(DISTURBANCE_SIZE):
        for lane in range(lanes):
            before = mean[field, lane] if substep > 0 else 0.0
            mean[field, lane] = before + share * (loads[field, lane] - before)
            if substep == substeps - 1:
                disturbance[field, lane] = mean[field, lane]
    return loads


@inlined
def _release(state: Any, hand: Any, disturbance: Any, *_: Any) -> Any:
    """Return the disturbance, in place of `_hold`."""
    return disturbance


@inlined
def _substep(
    state: Any, disturbance: Any, physics: Parameters, body: RigidPhysics, rigid: RigidSettings, lane: int, h: float
) -> Four:
    """Advance column `lane` by h, and return the mean of thrust (N) and torques (N·m), by Simpson's rule.

    The suffixes 0, m and 1 mean the start, the middle and the end of the substep.
    """
    rotors = rigid.rotors
    start, wanted = load_four(state, _ROTOR_THRUST, lane), load_four(state, _WANTED, lane)
    thrusts_1 = thrusts_after(start, wanted, rotors.rise.z, rotors.fall.z)
    wrench_0 = _wrench(thrusts_after(start, wanted, rotors.rise.x, rotors.fall.x), rigid)
    wrench_m = _wrench(thrusts_after(start, wanted, rotors.rise.y, rotors.fall.y), rigid)
    wrench_1 = _wrench(thrusts_1, rigid)
    motion = _motion(state, lane)
    before = rotation_matrix(motion.attitude)
    loads = _loads(state, disturbance, before, physics, rigid, lane)
    d1 = derivative(motion, wrench_0, loads, physics, body)
    d2 = derivative(moved(0.5 * h, d1.motion, motion), wrench_m, loads, physics, body)
    d3 = derivative(moved(0.5 * h, d2.motion, motion), wrench_m, loads, physics, body)
    d4 = derivative(moved(h, d3.motion, motion), wrench_1, loads, physics, body)
    end = moved(h / 6.0, d1.motion, moved(h / 3.0, d2.motion, moved(h / 3.0, d3.motion, motion)))
    end = moved(h / 6.0, d4.motion, end)
    attitude = normalised(end.attitude)
    r = scale(1.0 / norm(end.direction), end.direction)
    r_dot = axpy(-dot(r, end.direction_rate), r, end.direction_rate)

    rotation = rotation_matrix(attitude)
    centre = add(load(state, POSITION, lane), centre_from_body(before, motion.direction, physics, body))
    centre_rate = add(
        load(state, VELOCITY, lane),
        centre_rate_from_body(before, motion.rate, motion.direction_rate, physics, body),
    )
    middle = add(d2.centre, d3.centre)
    centre = axpy(h * h / 6.0, add(d1.centre, middle), axpy(h, centre_rate, centre))
    centre_rate = axpy(h / 6.0, add(axpy(2.0, middle, d1.centre), d4.centre), centre_rate)
    offset = centre_from_body(rotation, r, physics, body)
    offset_rate = centre_rate_from_body(rotation, end.rate, r_dot, physics, body)
    store(state, POSITION, lane, axpy(-1.0, offset, centre))
    store(state, VELOCITY, lane, axpy(-1.0, offset_rate, centre_rate))
    store(state, DIRECTION, lane, r)
    store(state, DIRECTION_RATE, lane, r_dot)
    store_four(state, _QUATERNION, lane, attitude)
    store(state, _BODY_RATE, lane, end.rate)
    store_four(state, _ROTOR_THRUST, lane, thrusts_1)
    torque = scale(1.0 / 6.0, add(axpy(4.0, wrench_m.torque, wrench_0.torque), wrench_1.torque))
    return Four((wrench_0.thrust + 4.0 * wrench_m.thrust + wrench_1.thrust) / 6.0, torque.x, torque.y, torque.z)


@inlined
def store_outputs(state: Any, lane: int) -> None:
    """Write the Euler angles, their rates and the thrust axis."""
    rotation: Rotation = rotation_matrix(_load_quaternion(state, lane))
    store(state, EULER, lane, euler_from_rotation(rotation, state[EULER + 2, lane]))
    store(state, EULER_RATE, lane, euler_rate(rotation, load(state, _BODY_RATE, lane)))
    store(state, THRUST_AXIS, lane, rotation.z)


@inlined
def _store_axis(state: Any, lane: int) -> None:
    store(state, THRUST_AXIS, lane, rotation_matrix(_load_quaternion(state, lane)).z)


@inlined
def _store_command(action: Any, rigid: RigidSettings, loops: Any, lane: int, state: Any, command: Any) -> None:
    """Write the thrust (N) and the torques (N·m) of the rotors."""
    wrench = wrench_of(load_four(state, _ROTOR_THRUST, lane), with_loop(rigid, loops, lane).rotors)
    store_four(command, 0, lane, wrench)


@inlined
def _integrate(hold: Any, arguments: Any) -> None:
    """Advance one block by a control period; `hold` is `_hold`, or `_release` where nothing can hold the pole."""
    state, issued, loops, disturbance, velocity, hand, physics, rigid, lanes, period, substeps, command = arguments
    for lane in range(lanes):
        add_drag(load(velocity, 0, lane), state, physics, lane, disturbance)
        body = rigid_physics(load_physics(physics, lane), rigid.correlation, rigid.pivot, rigid.shape)
        store_body(state, _BODY, lane, body)
        state[_MOMENTUM, lane] = 0.0
        store_four(command, 0, lane, Four(0.0, 0.0, 0.0, 0.0))
    acting = state[_ACTING:_WANTED]
    h, has_momentum = period / substeps, rigid.rotors.momentum > 0.0
    for substep in range(substeps):
        if substep == 0 or acts_later(loops, substep, lanes):
            find_acting(issued, loops, substep, lanes, acting)
        share = 1.0 / (substep + 1.0)
        for lane in range(lanes):
            _prepare(state, load_four(acting, 0, lane), velocity, with_loop(rigid, loops, lane), lane)
        if has_momentum:
            for lane in range(lanes):
                start, wanted = load_four(state, _ROTOR_THRUST, lane), load_four(state, _WANTED, lane)
                rotors = with_loop(rigid, loops, lane).rotors
                middle = thrusts_after(start, wanted, rotors.rise.y, rotors.fall.y)
                state[_MOMENTUM, lane] = propeller_momentum(middle, rotors)
        loads = hold(state, hand, disturbance, physics, rigid, loops, lanes, h, substep, substeps)
        for lane in range(lanes):
            parameters = load_physics(physics, lane)
            body = load_body(state, _BODY, lane, rigid.pivot, rigid.shape)
            mean = _substep(state, loads, parameters, body, with_loop(rigid, loops, lane), lane, h)
            add_mean(mean, share, lane, command)
    for lane in range(lanes):
        store_outputs(state, lane)


@inlined
def integrate_rigid(*arguments: Any) -> None:
    """Advance one block by a control period, as `integrate_euler`; nothing holds the pole."""
    _integrate(_release, arguments)


@inlined
def _integrate_held(*arguments: Any) -> None:
    _integrate(_hold, arguments)


_OTHERS = store_outputs, _store_axis, _store_command
RIGID_KERNEL = PlantKernel(RIGID_SIZE, RIGID_LANE_SIZE, integrate_rigid, *_OTHERS)
HELD_KERNEL = PlantKernel(RIGID_SIZE, RIGID_LANE_SIZE, _integrate_held, *_OTHERS)


@compiled
def advance_rigid(
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
    """Advance n states and their memories, shape (n, 11), in place by one period, see `plant_kernel.advance_rows`.

    `packed` is a packed `RigidSettings`.
    """
    rigid = unpack_rigid(packed)
    advance_rows(RIGID_KERNEL, state, memory, action, loops, disturbance, parameters, rigid, period, substeps)


@compiled
def _rigid_memory(state: Floats, hover: Four, memory: Floats) -> None:
    for row in range(state.shape[0]):
        euler, rate = load(state.T, EULER, row), load(state.T, EULER_RATE, row)
        store_four(memory.T, QUATERNION, row, quaternion_from_euler(euler))
        store(memory.T, BODY_RATE, row, body_rate(euler, rate))
        store_four(memory.T, ROTOR_THRUST, row, hover)


def rigid_from_state(state: Floats, simulation: Simulation) -> Floats:
    """Return quaternion, body rate and the rotor thrusts at hover, shape (n, 11), for states of shape (n, 18)."""
    memory = np.empty((len(state), RIGID_SIZE))
    _rigid_memory(np.ascontiguousarray(state), make_rigid_settings(simulation).rotors.hover, memory)
    return memory
