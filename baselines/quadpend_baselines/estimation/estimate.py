"""The layout of an estimate, and its parts as named views.

An estimate is a flat vector with this layout (`Estimate` names its parts):

| fields | name          | content                                                                                    |
|--------|---------------|--------------------------------------------------------------------------------------------|
| 0–17   | `state`       | x̂ as in `quadpend_gym.physics.state`; the position is relative to the anchor               |
| 18–26  | `disturbance` | d̂, laid out as `Disturbance`, N and N·m                                                    |
| 27–32  | `place`       | F_d, relative to the anchor, and Ḟ_d                                                       |
| 33–47  | `reference`   | F_d⁽ⁱ⁾ for i = 2 … 6 of the latest measurement                                             |
| 48–50  | `yaw`         | its ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s²                                                    |
| 51     | `mass_ratio`  | μ̂, effective ratio of weight to thrust, which scales the masses of quadrotor and bob      |
| 52     | `age`         | number of corrections since the episode began                                              |
| 53–70  | `innovation`  | measured minus predicted state before the latest correction; 0 for rates not measured      |
| 71–81  | `rigid`       | quaternion, body rate and rotor thrusts of a rigid vehicle, see `physics.rigid_kernel`     |
| 82–84  | `anchor`      | the place of the reference when the episode began, m                                       |
| 85–86  | `pole`        | believed length l (m) and mass (kg) of the pole, less the nominal ones                     |
| 87–98  |               | the latest sample, and counts of others, see `samples`                                     |
| 99–105 | `drag`        | velocity of the reference (m/s) and coefficients of the drag there, see `Derivatives`       |
| 106–   |               | memory of the known loop, see `loop.act`; with a latency that is not a whole number of     |
|        |               | periods then the action before                                                             |

A measurement has the same layout, with position and place in the world, the age of the sample (s), and zeros for what
is not measured. Where an observation has errors alone, the place is zero, and the anchor of an estimate moves with the
reference (`rebase`).

Laws are designed for the nominal length l₀ of the pole. With the believed length l they get the state of a vehicle at
ζ + (l − l₀) r, so that the tracked point ζ + l r is where it is.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    bob_offset,
    load_forces,
    load_reference,
    load_state,
)
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.attitude import body_rate, quaternion_from_euler
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, FORCE, POSITION, TORQUE, VELOCITY
from quadpend_gym.physics.vectors import Vec3, axpy, load, load_four, store, store_four

ORDERS = 5  # derivatives of the reference, of order 2 … 6
STATE, DISTURBANCE, PLACE, REFERENCE, YAW, MASS_RATIO, AGE, INNOVATION, RIGID_PART, ANCHOR, POLE = (
    *(0, 18, 27, 33, 48, 51, 52, 53, 71, 82, 85),
)
SAMPLE, HELD, REPEATED, REFUSED, DRAG, LOOP = 87, 96, 97, 98, 99, 106  # see `samples`
_MAX_HORIZONTAL = 0.95  # bound of |r_xy| of an estimate: 72° from upright; the default limit of an episode is 60°
LEAST_HEIGHT = float(np.sqrt(1.0 - _MAX_HORIZONTAL**2))  # r_z there


class _Part:
    """Fields of every estimate in an array, as a view."""

    def __init__(self, first: int, end: int) -> None:
        self.part = slice(first, end)

    def __get__(self, instance: Any, owner: type) -> Floats:
        view: Floats = instance.array[:, self.part]
        return view


class _Rows(NamedTuple):
    array: Floats  # shape (n, k)


class Estimate(_Rows):
    """Named views of n estimates, see the table above; writing into a view writes into the array."""

    state = _Part(STATE, DISTURBANCE)
    disturbance = _Part(DISTURBANCE, PLACE)
    place = _Part(PLACE, REFERENCE)
    yaw = _Part(YAW, MASS_RATIO)
    mass_ratio = _Part(MASS_RATIO, AGE)  # shape (n, 1)
    rigid = _Part(RIGID_PART, ANCHOR)

    @property
    def relative(self) -> Floats:
        """Return the state that laws get, relative to the reference, shape (n, 18)."""
        out, longer = self.state.copy(), self.array[:, POLE : POLE + 1]
        out[:, : VELOCITY + 3] -= self.place
        out[:, POSITION : POSITION + 2] += longer * out[:, DIRECTION : DIRECTION + 2]
        out[:, VELOCITY : VELOCITY + 2] += longer * out[:, DIRECTION_RATE : DIRECTION_RATE + 2]
        return out

    @property
    def reference(self) -> Floats:
        """Return the reference, shape (n, 5, 3)."""
        return self.array[:, REFERENCE:YAW].reshape(-1, ORDERS, 3)


def disturbance_of(estimate: Floats, weight: float) -> Floats:
    """Return the estimated disturbance of n rows in the layout of ``info["disturbance"]``, N and N·m, shape (n, 9).

    The vertical force includes the weight of the estimated deviation from the nominal mass; `weight` is nominal, N.
    """
    out: Floats = estimate[:, DISTURBANCE:PLACE].copy()
    out[:, FORCE + 2] -= (estimate[:, MASS_RATIO] - 1.0) * weight
    return out


def nominal(estimate: Estimate) -> Estimate:
    """Return the estimate relative to the reference, with the forces under which the nominal vehicle moves alike.

    A vehicle with μ times the mass moves under μ times the forces as the nominal one does.
    """
    out = Estimate(estimate.array.copy())
    out.state[:], out.place[:], out.array[:, POLE] = estimate.relative, 0.0, 0.0
    out.disturbance[:, :TORQUE] /= estimate.mass_ratio
    return out


@inlined
def moved(state: VehicleState, share: float, place: Any, lane: int) -> VehicleState:
    """Return a state with `share` times the place and the velocity that stand in the six fields of `place`."""
    s = state
    position = axpy(share, load(place, 0, lane), s.position)
    velocity = axpy(share, load(place, 3, lane), s.velocity)
    return VehicleState(position, velocity, s.euler, s.euler_rate, s.direction, s.direction_rate)


@inlined
def law_inputs(estimate: Any, row: int) -> tuple[VehicleState, Forces, Derivatives]:
    """Return state relative to the reference, disturbance and reference of an estimate, for a law.

    The yaw is within half a turn of the reference's.
    """
    lanes, d = estimate.T, load_reference(estimate.T, REFERENCE, row)
    velocity, drag = load(lanes, DRAG, row), load_four(lanes, DRAG + 3, row)
    reference = Derivatives(d.d2, d.d3, d.d4, d.d5, d.d6, d.yaw, velocity, drag)
    s = for_nominal_length(load_state(lanes, STATE, row), lanes[POLE, row])
    state = turned_to(moved(s, -1.0, lanes[PLACE:REFERENCE], row), reference.yaw.x)
    return state, load_forces(lanes, DISTURBANCE, row), reference


@inlined
def for_nominal_length(state: VehicleState, longer: float) -> VehicleState:
    """Return the state of a vehicle with a nominal pole whose tracked point is that of a pole longer by `longer`, m."""
    position, velocity = bob_offset(state, longer)
    return VehicleState(position, velocity, state.euler, state.euler_rate, state.direction, state.direction_rate)


@inlined
def near_angle(angle: float, other: float) -> float:
    """Return an angle less whole turns, within half a turn of another one, rad."""
    return float(angle - 2.0 * np.pi * np.rint((angle - other) / (2.0 * np.pi)))


@inlined
def rebase(memory: Any, lane: int, share: float) -> None:
    """Move the anchor to the reference, in place; `share` is 1, or 0 for an anchor that stays."""
    for i in range(REFERENCE - PLACE):
        memory[POSITION + i, lane] -= share * memory[PLACE + i, lane]
        memory[PLACE + i, lane] -= share * memory[PLACE + i, lane]


@inlined
def store_measured_reference(memory: Any, lane: int, seen: Any) -> None:
    """Write the reference of a measurement into an estimate, relative to its anchor, and the believed pole."""
    for i in range(MASS_RATIO - PLACE):
        memory[PLACE + i, lane] = seen[PLACE + i, lane]
    for i in range(3):
        memory[PLACE + i, lane] -= memory[ANCHOR + i, lane]
    for i in range(SAMPLE - POLE):
        memory[POLE + i, lane] = seen[POLE + i, lane]


@inlined
def measured_state(memory: Any, lane: int, seen: Any) -> VehicleState:
    """Return the state of a measurement relative to the anchor of an estimate."""
    s = load_state(seen, STATE, lane)
    position = axpy(-1.0, load(memory, ANCHOR, lane), s.position)
    return VehicleState(position, s.velocity, s.euler, s.euler_rate, s.direction, s.direction_rate)


@inlined
def turned_to(state: VehicleState, yaw: float) -> VehicleState:
    """Return a state with the yaw less whole turns, within half a turn of another yaw, rad."""
    s, euler = state, Vec3(state.euler.x, state.euler.y, near_angle(state.euler.z, yaw))
    return VehicleState(s.position, s.velocity, euler, s.euler_rate, s.direction, s.direction_rate)


@inlined
def project_direction(s: VehicleState) -> VehicleState:
    """Return the state with |r_xy| limited, and with r_z and ṙ_z such that |r| = 1, r_z > 0 and r·ṙ = 0."""
    r, r_dot = s.direction, s.direction_rate
    share = _MAX_HORIZONTAL / max(np.sqrt(r.x * r.x + r.y * r.y), _MAX_HORIZONTAL)
    x, y = share * r.x, share * r.y
    z = np.sqrt(1.0 - (x * x + y * y))
    rate = Vec3(r_dot.x, r_dot.y, -(x * r_dot.x + y * r_dot.y) / z)
    return VehicleState(s.position, s.velocity, s.euler, s.euler_rate, Vec3(x, y, z), rate)


@inlined
def store_attitude(memory: Any, lane: int, state: VehicleState) -> None:
    """Write quaternion and body rate of a state into the part of a rigid vehicle."""
    store_four(memory, RIGID_PART + QUATERNION, lane, quaternion_from_euler(state.euler))
    store(memory, RIGID_PART + BODY_RATE, lane, body_rate(state.euler, state.euler_rate))


@inlined
def is_bounded(memory: Any, lane: int, size: int, limit: float) -> bool:
    """Return whether the first `size` numbers are below a limit; false for nan as well."""
    out = True
    for i in range(size):
        out = out and abs(memory[i, lane]) < limit
    return out
