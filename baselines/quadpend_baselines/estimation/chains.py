"""The plant as integrator chains: the measurement of ADRC, and conversions between states and chains.

The symbols are those of `controllers.adrc` and `modelling.equivalent`:

    (1)  F = ζ + l r + a s + b t,    σ = (s + μ t)/(1 + μ)
    (2)  F̈ = g σ,    F⁽³⁾ = g σ̇,    F₅ = g K (σ − t),    Ḟ₅ = g K (σ̇ − ṫ)

For rigid vehicles, s = r_xy/r_z and t = b_xy/b_z are tangents. For the paper's vehicle they are r_xy and the tilt n.
All chains are relative to the reference.
"""

from typing import NamedTuple

import numpy as np

from quadpend_baselines.estimation.prediction import Measurement, project_direction
from quadpend_baselines.modelling.equivalent import EquivalentModel
from quadpend_baselines.modelling.planar import rotate
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State

# Observers: Luenberger stages of x and y, DESOs of x and y, height, yaw: chains of the state. Only the matched law has
# the DESOs of the force in x and y.
LUENBERGER, HORIZONTAL, HEIGHT, YAW, FORCE = slice(0, 2), slice(2, 4), 4, 5, slice(6, 8)
CHAINS = 6
# States of a DESO: output, rate, disturbance ϑ, its rate.
VALUE, RATE, DISTURBANCE = 0, 1, 2
_MAX_ANGLE_RATE, _MAX_VELOCITY = 100.0, 100.0  # rad/s and m/s, limits of the rates of a state


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


def equivalent_measurement(measurement: AdrcMeasurement, model: EquivalentModel) -> AdrcMeasurement:
    """Return the measurement with the angles, errors and reference of the equivalent pendulum."""
    reference, error = measurement.reference, measurement.error.copy()
    pendulum, tilt = model.tangents(measurement.direction, measurement.tilt, measurement.thrust_axis)
    error[:, :2] += model.pendulum_arm * pendulum + model.thrust_arm * tilt - model.reference_offset(reference)
    return measurement._replace(error=error, pendulum=pendulum, tilt=tilt, reference=model.reference(reference))


def measurement_of_state(measured: Measurement, model: EquivalentModel) -> AdrcMeasurement:
    """Return the equivalent measurement of a state; the inverse of `state_from_chains` in positions and angles."""
    s, yaw = State(measured.state), measured.yaw_reference[:, :1] * [0.0, 0.0, 1.0]
    error = s.position + model.vehicle.parameters.rod_length * np.array([1.0, 1.0, 0.0]) * s.direction
    measurement = make_measurement(error, s.direction, s.euler - yaw, measured.yaw_reference, measured.reference)
    return equivalent_measurement(measurement, model)


def state_from_chains(
    measured: Measurement, measurement: AdrcMeasurement, chains: Floats, model: EquivalentModel
) -> Floats:
    """Return states with measured positions and angles, and with the rates of the chains, shape (n, 18)."""
    state, p = measured.state.copy(), model.parameters
    s = State(state)
    third = measurement.reference_derivative(3)[:, :2] + chains[:, LUENBERGER, 3]
    fifth = measurement.reference_derivative(5)[:, :2] + chains[:, HORIZONTAL, RATE]
    sigma_rate = np.clip(third / p.gravity, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    tilt_rate = sigma_rate - fifth / (p.gravity * p.chain_stiffness)
    tilt_rate = np.clip(tilt_rate, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    if np.isnan(s.euler_rate[:1]).any():
        pitch_rate, roll_rate = (rotate(tilt_rate, -measurement.yaw, 0) * [1.0, -1.0]).T
        yaw_rate = chains[:, YAW, RATE] + measured.yaw_reference[:, 1]
        s.euler_rate[:] = np.column_stack([roll_rate, pitch_rate, yaw_rate])
        s.euler_rate[:] = np.clip(s.euler_rate, -_MAX_ANGLE_RATE, _MAX_ANGLE_RATE)
    pendulum_rate = model.pendulum(sigma_rate, tilt_rate)
    s.direction_rate[:, :2] = model.direction_rate(s.direction, pendulum_rate)
    velocity = chains[:, LUENBERGER, 1] - model.vehicle.parameters.rod_length * s.direction_rate[:, :2]
    velocity -= model.pendulum_arm * pendulum_rate + model.thrust_arm * tilt_rate
    velocity += model.reference_offset(measured.reference[:, 1:])
    s.velocity[:] = np.column_stack([velocity, chains[:, HEIGHT, RATE]])
    s.velocity[:] = np.clip(s.velocity, -_MAX_VELOCITY, _MAX_VELOCITY)
    project_direction(state)
    return state


def chains_of_state(measured: Measurement, measurement: AdrcMeasurement, model: EquivalentModel) -> Floats:
    """Return the states of the chains without disturbances, by equations (1) and (2), shape (n, 6, 4)."""
    s, p = State(measured.state), model.parameters
    rate = model.pendulum_rate(s.direction, s.direction_rate, measurement.pendulum)
    tilt_rate = model.tilt_rate(measured.state, measurement.yaw)
    sigma, sigma_rate = model.sigma(measurement.pendulum, measurement.tilt), model.sigma(rate, tilt_rate)
    velocity = s.velocity[:, :2] + model.vehicle.parameters.rod_length * s.direction_rate[:, :2]
    velocity += model.pendulum_arm * rate + model.thrust_arm * tilt_rate
    velocity -= model.reference_offset(measured.reference[:, 1:])
    second, third, fourth, fifth = (measurement.reference_derivative(order)[:, :2] for order in range(2, 6))
    stiffness = p.gravity * p.chain_stiffness
    chains = np.zeros((len(rate), CHAINS, 4))
    luenberger = [measurement.error[:, :2], velocity, p.gravity * sigma - second, p.gravity * sigma_rate - third]
    chains[:, LUENBERGER] = np.stack(luenberger, axis=-1)
    chains[:, HORIZONTAL, VALUE] = stiffness * (sigma - measurement.tilt) - fourth
    chains[:, HORIZONTAL, RATE] = stiffness * (sigma_rate - tilt_rate) - fifth
    chains[:, HEIGHT, VALUE], chains[:, HEIGHT, RATE] = measurement.error[:, 2], s.velocity[:, 2]
    chains[:, YAW, VALUE] = measurement.yaw_error
    chains[:, YAW, RATE] = s.euler_rate[:, 2] - measured.yaw_reference[:, 1]
    return chains
