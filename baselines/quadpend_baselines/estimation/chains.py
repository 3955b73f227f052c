"""The plant as integrator chains: the measurement of ADRC, and conversions between states and chains.

The symbols are those of `controllers.adrc` and `modelling.equivalent`:

    (1)  F = ζ + l r + a s + b t,    σ = (s + μ t)/(1 + μ)
    (2)  F̈ = g σ,    F⁽³⁾ = g σ̇,    F₅ = g K (σ − t),    Ḟ₅ = g K (σ̇ − ṫ)

For rigid vehicles, s = r_xy/r_z and t = b_xy/b_z are tangents. For the paper's vehicle they are r_xy and the tilt n.
All chains are relative to the reference.
"""

from typing import NamedTuple

import numpy as np

from quadpend_baselines.estimation.prediction import Estimate, Measurement, project_direction
from quadpend_baselines.modelling import taylor
from quadpend_baselines.modelling.equivalent import design_reference, equivalent_model, reference_offset
from quadpend_baselines.modelling.flat_outputs import attitude_from_tangent, tangent_from_attitude
from quadpend_baselines.modelling.planar import rotate
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State

# Observers: Luenberger stages of x and y, DESOs of x and y, height, yaw: chains of the state. Only the matched law has
# the DESOs of the force in x and y.
LUENBERGER, HORIZONTAL, HEIGHT, YAW, FORCE = slice(0, 2), slice(2, 4), 4, 5, slice(6, 8)
CHAINS = 6
# States of a DESO: output, rate, disturbance ϑ, its rate.
VALUE, RATE, DISTURBANCE = 0, 1, 2
_MAX_ANGLE_RATE, _MAX_VELOCITY = 100.0, 100.0  # rad/s and m/s, limits of the rates of a state
_LEAST_VERTICAL = 0.1  # lower bound of r_z and b_z in tangents
_MAX_ANGLE = 1.4  # rad, limit of roll and pitch in tangents


class AdrcMeasurement(NamedTuple):
    """Inputs of ADRC for n rows: positions, angles and the reference."""

    error: Floats  # e, m, shape (n, 3)
    direction: Floats  # r, shape (n, 3)
    pendulum: Floats  # s, shape (n, 2)
    tilt: Floats  # t, shape (n, 2)
    thrust_axis: Floats  # b, shape (n, 3)
    yaw: Floats  # ψ, rad, shape (n,)
    yaw_error: Floats  # ψ − ψ_d, rad, shape (n,)
    reference: Floats  # F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3)
    yaw_acceleration: Floats  # ψ̈_d, rad/s², shape (n,)

    def reference_derivative(self, order: int) -> Floats:
        """Return F_d⁽ⁱ⁾ of one order i from 2 to 6, shape (n, 3)."""
        return self.reference[:, order - 2]


def make_measurement(
    error: Floats, direction: Floats, euler: Floats, yaw_reference: Floats, reference: Floats
) -> AdrcMeasurement:
    """Return the measurement of n rows.

    Args:
        error: e, m, shape (n, 3).
        direction: r, shape (n, 3).
        euler: φ, θ and the yaw error ψ − ψ_d, rad, shape (n, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d, in rad, rad/s and rad/s², shape (n, 3).
        reference: F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3).
    """
    roll, pitch, yaw_error = euler.T
    yaw = yaw_error + yaw_reference[:, 0]
    # In the axes of the heading, the horizontal thrust direction is (cos φ sin θ, −sin φ).
    horizontal = np.stack([np.cos(roll) * np.sin(pitch), -np.sin(roll)], axis=-1)
    tilt = rotate(np.stack([pitch, -roll], axis=-1), yaw, 0)
    axis = np.column_stack([rotate(horizontal, yaw, 0), np.cos(roll) * np.cos(pitch)])
    pendulum = direction[:, :2]
    return AdrcMeasurement(error, direction, pendulum, tilt, axis, yaw, yaw_error, reference, yaw_reference[:, 2])


def equivalent_measurement(measurement: AdrcMeasurement, simulation: Simulation) -> AdrcMeasurement:
    """Return the measurement of a rigid vehicle with tangents, and errors and reference of the equivalent pendulum."""
    if not simulation.is_rigid:
        return measurement
    model, reference, error = equivalent_model(simulation), measurement.reference, measurement.error.copy()
    pendulum = measurement.direction[:, :2] / np.maximum(measurement.direction[:, 2:], _LEAST_VERTICAL)
    tilt = measurement.thrust_axis[:, :2] / np.maximum(measurement.thrust_axis[:, 2:], _LEAST_VERTICAL)
    error[:, :2] += model.pendulum_arm * pendulum + model.thrust_arm * tilt - reference_offset(reference, simulation)
    reference = design_reference(reference, simulation)
    return measurement._replace(error=error, pendulum=pendulum, tilt=tilt, reference=reference)


def measurement_of_state(measured: Measurement, simulation: Simulation) -> AdrcMeasurement:
    """Return the equivalent measurement of a state; the inverse of `state_from_chains` in positions and angles."""
    s, yaw = State(measured.state), measured.yaw_reference[:, :1] * [0.0, 0.0, 1.0]
    error = s.position + simulation.parameters.rod_length * np.array([1.0, 1.0, 0.0]) * s.direction
    measurement = make_measurement(error, s.direction, s.euler - yaw, measured.yaw_reference, measured.reference)
    return equivalent_measurement(measurement, simulation)


def state_from_chains(
    measured: Measurement, measurement: AdrcMeasurement, chains: Floats, simulation: Simulation
) -> Floats:
    """Return states with measured positions and angles, and with the rates of the chains, shape (n, 18).

    Args:
        measured: The measurement; its Euler-angle rates are taken if they are measured.
        measurement: The equivalent measurement.
        chains: States of the observers, shape (n, 6, 4) or (n, 8, 4).
        simulation: Nominal plant.
    """
    model, state = equivalent_model(simulation), measured.state.copy()
    s, gravity = State(state), model.parameters.gravity
    third = measurement.reference_derivative(3)[:, :2] + chains[:, LUENBERGER, 3]
    fifth = measurement.reference_derivative(5)[:, :2] + chains[:, HORIZONTAL, RATE]
    pendulum_rate = np.clip(third / gravity, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    tilt_rate = pendulum_rate - fifth / (gravity * model.parameters.chain_stiffness)
    tilt_rate = np.clip(tilt_rate, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    if np.isnan(s.euler_rate[:1]).any():
        pitch_rate, roll_rate = (rotate(tilt_rate, -measurement.yaw, 0) * [1.0, -1.0]).T
        yaw_rate = chains[:, YAW, RATE] + measured.yaw_reference[:, 1]
        s.euler_rate[:] = np.column_stack([roll_rate, pitch_rate, yaw_rate])
        s.euler_rate[:] = np.clip(s.euler_rate, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    pole_rate = (pendulum_rate - model.pivot_share * tilt_rate) / (1.0 - model.pivot_share)
    s.direction_rate[:, :2] = pole_rate
    if simulation.is_rigid:
        horizontal, r_z = s.direction[:, :2], s.direction[:, 2:]
        along = np.sum(horizontal * pole_rate, axis=1, keepdims=True)
        s.direction_rate[:, :2] = r_z * (pole_rate - along * horizontal)
    velocity = chains[:, LUENBERGER, 1] - simulation.parameters.rod_length * s.direction_rate[:, :2]
    velocity -= model.pendulum_arm * pole_rate + model.thrust_arm * tilt_rate
    if simulation.is_rigid:
        velocity += reference_offset(measured.reference[:, 1:], simulation)
    s.velocity[:] = np.column_stack([velocity, chains[:, HEIGHT, RATE]])
    s.velocity[:] = np.clip(s.velocity, -_MAX_VELOCITY, _MAX_VELOCITY)
    project_direction(state)
    return state


def chains_of_state(measured: Measurement, measurement: AdrcMeasurement, simulation: Simulation) -> Floats:
    """Return the states of the chains without disturbances, by equations (1) and (2), shape (n, 6, 4).

    Args:
        measured: A complete state with its reference.
        measurement: The equivalent measurement of this state.
        simulation: Nominal plant.
    """
    model, s = equivalent_model(simulation), State(measured.state)
    p, rate = model.parameters, s.direction_rate[:, :2]
    tilt_rate = rotate(s.euler_rate[:, [1, 0]] * [1.0, -1.0], measurement.yaw, 0)
    if simulation.is_rigid:
        tilt_rate = tilt_series(measured.state)[1]
        rate = (rate - measurement.pendulum * s.direction_rate[:, 2:]) / np.maximum(s.direction[:, 2:], _LEAST_VERTICAL)
    pendulum = pendulum_of(measurement, simulation)
    pendulum_rate = rate + model.pivot_share * (tilt_rate - rate)
    velocity = s.velocity[:, :2] + simulation.parameters.rod_length * s.direction_rate[:, :2]
    velocity += model.pendulum_arm * rate + model.thrust_arm * tilt_rate
    if simulation.is_rigid:
        velocity -= reference_offset(measured.reference[:, 1:], simulation)
    second, third, fourth, fifth = (measurement.reference_derivative(order)[:, :2] for order in range(2, 6))
    stiffness = p.gravity * p.chain_stiffness
    chains = np.zeros((len(rate), CHAINS, 4))
    luenberger = [measurement.error[:, :2], velocity, p.gravity * pendulum - second, p.gravity * pendulum_rate - third]
    chains[:, LUENBERGER] = np.stack(luenberger, axis=-1)
    chains[:, HORIZONTAL, VALUE] = stiffness * (pendulum - measurement.tilt) - fourth
    chains[:, HORIZONTAL, RATE] = stiffness * (pendulum_rate - tilt_rate) - fifth
    chains[:, HEIGHT, VALUE], chains[:, HEIGHT, RATE] = measurement.error[:, 2], s.velocity[:, 2]
    chains[:, YAW, VALUE] = measurement.yaw_error
    chains[:, YAW, RATE] = s.euler_rate[:, 2] - measured.yaw_reference[:, 1]
    return chains


def tilt_series(state: Floats) -> Floats:
    """Return the Taylor series of the tangent t of states, order 1, shape (2, n, 2)."""
    s = State(state)
    euler = np.column_stack([np.clip(s.euler[:, :2], -_MAX_ANGLE, _MAX_ANGLE), s.euler[:, 2]])
    return tangent_from_attitude(taylor.from_derivatives(euler, s.euler_rate))


def euler_accelerations(state: Floats, acceleration: Floats, simulation: Simulation) -> Floats:
    """Return the accelerations of the Euler angles that make those of the tilt, rad/s², shape (n, 3).

    Args:
        state: States, shape (n, 18).
        acceleration: ẗ in the axes of the heading, as accelerations of φ and θ near hover, and ψ̈, shape (n, 3).
        simulation: Without a rigid vehicle, both are the same.
    """
    if not simulation.is_rigid:
        return acceleration
    s, series = State(state), tilt_series(state)
    second = rotate(acceleration[:, [1, 0]] * [1.0, -1.0], s.euler[:, 2], 0)
    yaw = taylor.from_derivatives(s.euler[:, 2], s.euler_rate[:, 2], acceleration[:, 2])
    attitude = attitude_from_tangent(np.stack([*series, 0.5 * second]), yaw)
    return np.asarray(taylor.to_derivatives(attitude)[2])


def mean_accelerations(before: Estimate, after: Estimate, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return the mean of z̈ (m/s²), shape (n,), and of the accelerations of tilt and yaw (rad/s²), shape (n, 3).

    Args:
        before: The plant at the beginning of a control period.
        after: The plant at its end, relative to a reference that does not accelerate.
        simulation: Defines the control period and the attitude model.

    Returns:
        z̈ and the accelerations as in `euler_accelerations`.
    """
    first, last, period = State(before.state), State(after.state), simulation.period
    angular = (last.euler_rate - first.euler_rate) / period
    if simulation.is_rigid:
        tilt = (tilt_series(after.state)[1] - tilt_series(before.state)[1]) / period
        angular[:, [1, 0]] = rotate(tilt, -first.euler[:, 2], 0) * [1.0, -1.0]
    return (last.velocity[:, 2] - first.velocity[:, 2]) / period, angular


def pendulum_of(measurement: AdrcMeasurement, simulation: Simulation) -> Floats:
    """Return σ of the equivalent pendulum, r_xy without a rigid vehicle, shape (n, 2)."""
    share = equivalent_model(simulation).pivot_share
    return measurement.pendulum + share * (measurement.tilt - measurement.pendulum)
