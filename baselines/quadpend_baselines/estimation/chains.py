"""The plant as integrator chains: the measurement of ADRC, and conversions between states and chains.

The symbols are those of `controllers.adrc` and `modelling.equivalent`:

    (1)  F = ζ + l r + a s + b t,    σ = (s + μ t)/(1 + μ)
    (2)  F̈ = g σ,    F⁽³⁾ = g σ̇,    F₅ = g K (σ − t),    Ḟ₅ = g K (σ̇ − ṫ)

For rigid vehicles, s = r_xy/r_z and t = b_xy/b_z are tangents. For the paper's vehicle they are r_xy and the tilt n.
All chains are relative to the reference.
"""

from typing import Any, NamedTuple

from quadpend_baselines.estimation.estimator import (
    ATTITUDE,
    DIRECTION,
    TRACKING_ERROR,
    project_direction,
    read_reference,
    scaled_vector,
)
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    chain_stiffness,
    equivalent_reference,
    pendulum_of,
    sigma_of,
)
from quadpend_baselines.modelling.flat_outputs import Pair, attitude_from_tangent, tangent_from_attitude
from quadpend_baselines.modelling.quantities import Derivatives, Vec2, VehicleState, bob_offset, turn
from quadpend_baselines.modelling.taylor import Series, from_derivatives
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.rigid_settings import RigidSettings
from quadpend_gym.physics.vectors import Vec3

# Observers, each with four states: Luenberger stages of x and y, DESOs of x and y, height, yaw: chains of the state.
# Only the matched law has the DESOs of the force in x and y.
LUENBERGER, HORIZONTAL, HEIGHT, YAW, FORCE = 0, 8, 16, 20, 24  # first fields of the observers of x, of height and yaw
NEXT = 4  # from an observer to the next one, from x to y
OBSERVERS_SIZE = 32
# States of a DESO: output, rate, disturbance ϑ, its rate.
VALUE, RATE, DISTURBANCE = 0, 1, 2
_LEAST_VERTICAL = 0.1  # lower bound of r_z and b_z in tangents
_MAX_ANGLE = 1.4  # rad, limit of roll and pitch in tangents
_MAX_ANGLE_RATE, _MAX_VELOCITY = 100.0, 100.0  # rad/s and m/s, limits of the rates of a state


class AdrcMeasurement(NamedTuple):
    """Inputs of ADRC: positions, angles and the reference, those of the equivalent pendulum."""

    error: Vec3  # e, m
    direction: Vec3  # r
    pendulum: Vec2  # s
    tilt: Vec2  # t
    thrust_axis: Vec3  # b
    yaw: float  # ψ, rad
    yaw_error: float  # ψ − ψ_d, rad
    reference: Derivatives


@inlined
def make_measurement(
    error: Vec3, direction: Vec3, euler: Vec3, reference: Derivatives, model: Pendulum, rigid: RigidSettings | None
) -> AdrcMeasurement:
    """Return the measurement for tracking error e (m), direction r, and roll, pitch and yaw error ψ − ψ_d (rad)."""
    yaw = euler.z + reference.yaw.x
    (sin_roll, cos_roll), (sin_pitch, cos_pitch), (sine, cosine) = sincos(euler.x), sincos(euler.y), sincos(yaw)
    # In the axes of the heading, the horizontal thrust direction is (cos φ sin θ, −sin φ).
    axis = turn(Vec2(cos_roll * sin_pitch, -sin_roll), sine, cosine)
    b = Vec3(axis.x, axis.y, cos_roll * cos_pitch)
    if rigid is None:
        s, t = Vec2(direction.x, direction.y), turn(Vec2(euler.y, -euler.x), sine, cosine)
    else:
        r_z, b_z = max(direction.z, _LEAST_VERTICAL), max(b.z, _LEAST_VERTICAL)
        s, t = Vec2(direction.x / r_z, direction.y / r_z), Vec2(b.x / b_z, b.y / b_z)
    offset = _offset(reference.d2, reference.d4, model)
    moved = Vec3(
        error.x + model.pendulum_arm * s.x + model.thrust_arm * t.x - offset.x,
        error.y + model.pendulum_arm * s.y + model.thrust_arm * t.y - offset.y,
        error.z,
    )
    return AdrcMeasurement(moved, direction, s, t, b, yaw, euler.z, equivalent_reference(reference, model))


@inlined
def _offset(second: Vec3, fourth: Vec3, model: Pendulum) -> Vec2:
    """Return F − F_d of the wanted F, or its rate, from the derivatives of F_d of two orders, m."""
    return Vec2(model.second * second.x + model.fourth * fourth.x, model.second * second.y + model.fourth * fourth.y)


@inlined
def read_measurement(
    observation: Any, first: int, lane: int, model: Pendulum, rigid: RigidSettings | None
) -> AdrcMeasurement:
    """Return the measurement in an observation without rates, which begins in row `first`."""
    error = scaled_vector(observation, first, TRACKING_ERROR, lane)
    direction = scaled_vector(observation, first + 3, DIRECTION, lane)
    euler = scaled_vector(observation, first + 6, ATTITUDE, lane)
    return make_measurement(error, direction, euler, read_reference(observation, first + 9, lane), model, rigid)


@inlined
def measurement_of_state(
    s: VehicleState, reference: Derivatives, model: Pendulum, rigid: RigidSettings | None
) -> AdrcMeasurement:
    """Return the measurement of a state; the inverse of `state_from_chains` in positions and angles."""
    error, _ = bob_offset(s, model.vehicle.rod_length)
    euler = Vec3(s.euler.x, s.euler.y, s.euler.z - reference.yaw.x)
    return make_measurement(error, s.direction, euler, reference, model, rigid)


@inlined
def _limited(v: Vec2, limit: float) -> Vec2:
    return Vec2(min(max(v.x, -limit), limit), min(max(v.y, -limit), limit))


@inlined
def _limited3(v: Vec3, limit: float) -> Vec3:
    return Vec3(min(max(v.x, -limit), limit), min(max(v.y, -limit), limit), min(max(v.z, -limit), limit))


@inlined
def state_from_chains(
    measured: VehicleState,
    has_rates: bool,
    reference: Derivatives,
    measurement: AdrcMeasurement,
    chains: Any,
    lane: int,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> VehicleState:
    """Return the state with measured positions and angles, and with the rates of the chains.

    Rates of the Euler angles that are measured stay; `chains` has the observers from row 0.
    """
    p, wanted, r = model.physics, measurement.reference, measured.direction
    stiffness, g = p.gravity * chain_stiffness(p), p.gravity
    third_x = wanted.d3.x + chains[LUENBERGER + 3, lane]
    third_y = wanted.d3.y + chains[LUENBERGER + NEXT + 3, lane]
    sigma_rate = _limited(Vec2(third_x / g, third_y / g), _MAX_ANGLE_RATE)
    fifth_x = wanted.d5.x + chains[HORIZONTAL + RATE, lane]
    fifth_y = wanted.d5.y + chains[HORIZONTAL + NEXT + RATE, lane]
    tilt_rate = Vec2(sigma_rate.x - fifth_x / stiffness, sigma_rate.y - fifth_y / stiffness)
    tilt_rate = _limited(tilt_rate, _MAX_ANGLE_RATE)
    euler_rate = measured.euler_rate
    if not has_rates:
        sine, cosine = sincos(measurement.yaw)
        turned, yaw_rate = turn(tilt_rate, -sine, cosine), chains[YAW + RATE, lane] + reference.yaw.y
        euler_rate = _limited3(Vec3(-turned.y, turned.x, yaw_rate), _MAX_ANGLE_RATE)
    s_rate = pendulum_of(sigma_rate, tilt_rate, model)
    r_rate = s_rate
    if rigid is not None:
        along = r.x * s_rate.x + r.y * s_rate.y
        r_rate = Vec2(r.z * (s_rate.x - along * r.x), r.z * (s_rate.y - along * r.y))
    length, a, b = model.vehicle.rod_length, model.pendulum_arm, model.thrust_arm
    offset = _offset(reference.d3, reference.d5, model)
    velocity = Vec3(
        chains[LUENBERGER + 1, lane] - length * r_rate.x - (a * s_rate.x + b * tilt_rate.x) + offset.x,
        chains[LUENBERGER + NEXT + 1, lane] - length * r_rate.y - (a * s_rate.y + b * tilt_rate.y) + offset.y,
        chains[HEIGHT + RATE, lane],
    )
    velocity = _limited3(velocity, _MAX_VELOCITY)
    rate = Vec3(r_rate.x, r_rate.y, 0.0)
    return project_direction(VehicleState(measured.position, velocity, measured.euler, euler_rate, r, rate))


@inlined
def tilt_of_state(s: VehicleState) -> Pair:
    """Return the Taylor series of the tangents t of a state, known to order 1."""
    euler = Vec3(min(max(s.euler.x, -_MAX_ANGLE), _MAX_ANGLE), min(max(s.euler.y, -_MAX_ANGLE), _MAX_ANGLE), s.euler.z)
    return tangent_from_attitude(euler, s.euler_rate)


@inlined
def tilt_rate_of(s: VehicleState, yaw: float, rigid: RigidSettings | None) -> Vec2:
    """Return ṫ of a state, rad/s."""
    if rigid is None:
        sine, cosine = sincos(yaw)
        return turn(Vec2(s.euler_rate.y, -s.euler_rate.x), sine, cosine)
    series = tilt_of_state(s)
    return Vec2(series.x.b, series.y.b)


@inlined
def chains_of_state(
    s: VehicleState,
    reference: Derivatives,
    measurement: AdrcMeasurement,
    model: Pendulum,
    rigid: RigidSettings | None,
    sign: float,
    chains: Any,
    lane: int,
) -> None:
    """Add the states of the chains without disturbances, by equations (1) and (2), times `sign`, in place."""
    p, m, wanted = model.physics, measurement, measurement.reference
    g, stiffness = p.gravity, p.gravity * chain_stiffness(p)
    r, r_dot = s.direction, s.direction_rate
    s_rate, t_rate = Vec2(r_dot.x, r_dot.y), tilt_rate_of(s, m.yaw, rigid)
    if rigid is not None:
        r_z = max(r.z, _LEAST_VERTICAL)
        s_rate = Vec2((r_dot.x - m.pendulum.x * r_dot.z) / r_z, (r_dot.y - m.pendulum.y * r_dot.z) / r_z)
    sigma, sigma_rate = sigma_of(m.pendulum, m.tilt, model), sigma_of(s_rate, t_rate, model)
    offset, (_, rate) = _offset(reference.d3, reference.d5, model), bob_offset(s, model.vehicle.rod_length)
    a, b = model.pendulum_arm, model.thrust_arm
    stages = (  # the Luenberger stages of x and y
        m.error.x,
        rate.x + a * s_rate.x + b * t_rate.x - offset.x,
        g * sigma.x - wanted.d2.x,
        g * sigma_rate.x - wanted.d3.x,
        m.error.y,
        rate.y + a * s_rate.y + b * t_rate.y - offset.y,
        g * sigma.y - wanted.d2.y,
        g * sigma_rate.y - wanted.d3.y,
    )
    outputs = (  # value and rate of the DESOs
        stiffness * (sigma.x - m.tilt.x) - wanted.d4.x,
        stiffness * (sigma_rate.x - t_rate.x) - wanted.d5.x,
        stiffness * (sigma.y - m.tilt.y) - wanted.d4.y,
        stiffness * (sigma_rate.y - t_rate.y) - wanted.d5.y,
        m.error.z,
        s.velocity.z,
        m.yaw_error,
        s.euler_rate.z - reference.yaw.y,
    )
    for i in range(8):
        chains[i, lane] += sign * stages[i]
    for i in range(4):
        chains[HORIZONTAL + 4 * i, lane] += sign * outputs[2 * i]
        chains[HORIZONTAL + 4 * i + 1, lane] += sign * outputs[2 * i + 1]


@inlined
def euler_accelerations(s: VehicleState, acceleration: Vec3, rigid: RigidSettings | None) -> Vec3:
    """Return the accelerations of the Euler angles that make those of tilt and yaw, rad/s².

    Args:
        s: State.
        acceleration: ẗ in the axes of the heading, as accelerations of φ and θ near hover, and ψ̈.
        rigid: Settings of a rigid vehicle; None: the paper's vehicle.
    """
    if rigid is None:
        return acceleration
    sine, cosine = sincos(s.euler.z)
    second, t = turn(Vec2(acceleration.y, -acceleration.x), sine, cosine), tilt_of_state(s)
    x = Series(t.x.a, t.x.b, 0.5 * second.x, 0.0, 0.0)
    y = Series(t.y.a, t.y.b, 0.5 * second.y, 0.0, 0.0)
    heading = from_derivatives(s.euler.z, s.euler_rate.z, acceleration.z, 0.0, 0.0)
    roll, pitch = attitude_from_tangent(Pair(x, y), heading)
    return Vec3(2.0 * roll.c, 2.0 * pitch.c, acceleration.z)
