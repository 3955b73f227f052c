"""The plant as integrator chains: the measurement of ADRC, and conversions between states and chains.

The symbols are those of `controllers.adrc` and `modelling.equivalent`:

    (1)  F = ζ + l r + a s + b t,    σ = (s + μ t)/(1 + μ)
    (2)  F̈ = g σ,    F⁽³⁾ = g σ̇,    F₅ = g K (σ − t),    Ḟ₅ = g K (σ̇ − ṫ)

For rigid vehicles, s = r_xy/r_z and t = b_xy/b_z are tangents. For the paper's vehicle they are r_xy and the tilt n.
All chains are relative to the reference.
"""

from typing import Any, NamedTuple

from quadpend_baselines.estimation.estimate import project_direction
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    chain_stiffness,
    equivalent_reference,
    flat_output,
    pendulum_of,
    sigma_of,
)
from quadpend_baselines.modelling.flat_outputs import coefficients, euler_accelerations, tangent_from_attitude
from quadpend_baselines.modelling.quantities import Derivatives, VehicleState, bob_offset, divide, minus, turn3
from quadpend_baselines.modelling.trajectory_drag import no_drag
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.rigid_settings import RigidSettings
from quadpend_gym.physics.vectors import Vec3, add, axpy, scale

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
    pendulum: Vec3  # s, horizontal
    tilt: Vec3  # t, horizontal
    thrust_axis: Vec3  # b
    yaw: float  # ψ, rad
    yaw_error: float  # ψ − ψ_d, rad
    reference: Derivatives


@inlined
def measurement_of_state(
    state: VehicleState, reference: Derivatives, model: Pendulum, rigid: RigidSettings | None
) -> AdrcMeasurement:
    """Return the measurement of a state; the inverse of `state_from_chains` in positions and angles."""
    (error, _), euler, direction = bob_offset(state, model.vehicle.rod_length), state.euler, state.direction
    yaw_error = euler.z - reference.yaw.x
    yaw = yaw_error + reference.yaw.x  # rounded like the observed one
    (sin_roll, cos_roll), (sin_pitch, cos_pitch), (sine, cosine) = sincos(euler.x), sincos(euler.y), sincos(yaw)
    # In the axes of the heading, the horizontal thrust direction is (cos φ sin θ, −sin φ).
    b = turn3(Vec3(cos_roll * sin_pitch, -sin_roll, cos_roll * cos_pitch), sine, cosine)
    if rigid is None:
        s, t = direction, turn3(Vec3(euler.y, -euler.x, 0.0), sine, cosine)
    else:
        s, t = divide(direction, max(direction.z, _LEAST_VERTICAL)), divide(b, max(b.z, _LEAST_VERTICAL))
    wanted = equivalent_reference(reference, no_drag(), model)
    output = minus(flat_output(error, s, t, model), _offset(wanted.d2, wanted.d4, model))
    return AdrcMeasurement(Vec3(output.x, output.y, error.z), direction, s, t, b, yaw, yaw_error, wanted)


@inlined
def _offset(second: Vec3, fourth: Vec3, model: Pendulum) -> Vec3:
    """Return F − F_d of the wanted F without drag, or its rate, from two of its derivatives, m."""
    return axpy(model.second, second, scale(model.fourth, fourth))


@inlined
def of_both_axes(chains: Any, field: int, lane: int) -> Vec3:
    """Return a field of the observers of x and y."""
    return Vec3(chains[field, lane], chains[field + NEXT, lane], 0.0)


@inlined
def _limited(v: Vec3, limit: float) -> Vec3:
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
    third = add(wanted.d3, of_both_axes(chains, LUENBERGER + 3, lane))
    sigma_rate = _limited(divide(third, g), _MAX_ANGLE_RATE)
    fifth = add(wanted.d5, of_both_axes(chains, HORIZONTAL + RATE, lane))
    tilt_rate = _limited(minus(sigma_rate, divide(fifth, stiffness)), _MAX_ANGLE_RATE)
    euler_rate = measured.euler_rate
    if not has_rates:
        sine, cosine = sincos(measurement.yaw)
        turned, yaw_rate = turn3(tilt_rate, -sine, cosine), chains[YAW + RATE, lane] + reference.yaw.y
        euler_rate = _limited(Vec3(-turned.y, turned.x, yaw_rate), _MAX_ANGLE_RATE)
    s_rate = pendulum_of(sigma_rate, tilt_rate, model)
    r_rate = s_rate
    if rigid is not None:
        along = r.x * s_rate.x + r.y * s_rate.y
        r_rate = scale(r.z, axpy(-along, r, s_rate))
    arms = axpy(model.thrust_arm, tilt_rate, scale(model.pendulum_arm, s_rate))
    velocity = axpy(-model.vehicle.rod_length, r_rate, of_both_axes(chains, LUENBERGER + 1, lane))
    velocity = add(minus(velocity, arms), _offset(wanted.d3, wanted.d5, model))
    velocity = _limited(Vec3(velocity.x, velocity.y, chains[HEIGHT + RATE, lane]), _MAX_VELOCITY)
    rate = Vec3(r_rate.x, r_rate.y, 0.0)
    return project_direction(VehicleState(measured.position, velocity, measured.euler, euler_rate, r, rate))


@inlined
def _tilt_of_state(s: VehicleState) -> tuple[Vec3, Vec3]:
    """Return the tangents t of a state and their rates."""
    euler = Vec3(min(max(s.euler.x, -_MAX_ANGLE), _MAX_ANGLE), min(max(s.euler.y, -_MAX_ANGLE), _MAX_ANGLE), s.euler.z)
    tilt, rate, _ = coefficients(tangent_from_attitude(euler, s.euler_rate))
    return tilt, rate


@inlined
def tilt_rate_of(s: VehicleState, yaw: float, rigid: RigidSettings | None) -> Vec3:
    """Return ṫ of a state, rad/s."""
    if rigid is None:
        sine, cosine = sincos(yaw)
        return turn3(Vec3(s.euler_rate.y, -s.euler_rate.x, 0.0), sine, cosine)
    return _tilt_of_state(s)[1]


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
    s_rate, t_rate = s.direction_rate, tilt_rate_of(s, m.yaw, rigid)
    if rigid is not None:
        s_rate = divide(axpy(-s_rate.z, m.pendulum, s_rate), max(s.direction.z, _LEAST_VERTICAL))
    sigma, sigma_rate = sigma_of(m.pendulum, m.tilt, model), sigma_of(s_rate, t_rate, model)
    _, rate = bob_offset(s, model.vehicle.rod_length)
    first = minus(flat_output(rate, s_rate, t_rate, model), _offset(wanted.d3, wanted.d5, model))
    second, third = minus(scale(g, sigma), wanted.d2), minus(scale(g, sigma_rate), wanted.d3)
    fourth = minus(scale(stiffness, minus(sigma, m.tilt)), wanted.d4)
    fifth = minus(scale(stiffness, minus(sigma_rate, t_rate)), wanted.d5)
    chains_of_output = m.error, first, second, third
    for i in range(4):
        chains[LUENBERGER + i, lane] += sign * chains_of_output[i].x
        chains[LUENBERGER + NEXT + i, lane] += sign * chains_of_output[i].y
    values = fourth.x, fourth.y, m.error.z, m.yaw_error
    rates = fifth.x, fifth.y, s.velocity.z, s.euler_rate.z - reference.yaw.y
    for i in range(4):
        chains[HORIZONTAL + NEXT * i, lane] += sign * values[i]
        chains[HORIZONTAL + NEXT * i + RATE, lane] += sign * rates[i]


@inlined
def attitude_accelerations(s: VehicleState, acceleration: Vec3, rigid: RigidSettings | None) -> Vec3:
    """Return the accelerations of the Euler angles that make those of tilt and yaw, rad/s².

    Args:
        s: State.
        acceleration: ẗ in the axes of the heading, as accelerations of φ and θ near hover, and ψ̈.
        rigid: Settings of a rigid vehicle; None: the paper's vehicle.
    """
    if rigid is None:
        return acceleration
    sine, cosine = sincos(s.euler.z)
    tilt, rate = _tilt_of_state(s)
    second = turn3(Vec3(acceleration.y, -acceleration.x, 0.0), sine, cosine)
    return euler_accelerations(tilt, rate, second, Vec3(s.euler.z, s.euler_rate.z, acceleration.z))
