"""LQR and LQI: optimal linear feedback around hover, on top of the reference's exact flight.

    (1)  u = u_d − K (x − x_d),   K = (R + BᵀPB)⁻¹ BᵀPA       P: discrete algebraic Riccati equation
    (2)  J = ½ Σ (x_kᵀ Q x_k + u_kᵀ R u_k) = ½ x₀ᵀ P x₀

x and u are those of `linear_model` in the heading's axes, x_d and u_d the calm flight of `flat_outputs`. Q weighs the
flat outputs' errors e = (ζ_x + l r_x, ζ_y + l r_y, ζ_z), their rates, the lean of the thrust, ψ and the angular rates;
each weight is the inverse square of a tolerance (Bryson's rule). LQI appends σ_{k+1} = σ_k + T e_k to x. It integrates
only while the command is within the actuators' limits, and each component of σ is bounded. Positions farther off than
`reach` count as that far, or linear feedback would lean further than it can come back from.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from quadpend_baselines.estimation.estimator import Estimate, Measurement
from quadpend_baselines.gains import LqrGains
from quadpend_baselines.modelling import flat_outputs
from quadpend_baselines.modelling.linear_model import (
    EULER_RATE,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    POSITION,
    STATE_COLUMNS,
    VELOCITY,
    linearise,
    rotate_state,
)
from quadpend_baselines.modelling.planar import limit_norm, rotate
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats

_OUTPUTS = 3


def output_matrix(rod_length: float) -> Floats:
    """C of e = C x, shape (3, 16)."""
    out = np.zeros((_OUTPUTS, MODEL_STATE_SIZE))
    out[:, POSITION] = np.eye(_OUTPUTS)
    out[:2, PENDULUM] = rod_length * np.eye(2)
    return out


@lru_cache(maxsize=32)
def weights(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Q and R of equation (2), shapes (16, 16), or (19, 19) with integrators, and (4, 4)."""
    output = output_matrix(simulation.parameters.rod_length)
    rate = np.zeros_like(output)
    rate[:, VELOCITY], rate[:, PENDULUM_RATE] = output[:, POSITION], output[:, PENDULUM]
    state = output.T @ output / gains.position**2 + rate.T @ rate / gains.velocity**2
    angle, turning = np.zeros(MODEL_STATE_SIZE), np.zeros(MODEL_STATE_SIZE)
    angle[[6, 7, 8]] = gains.angle**-2
    turning[EULER_RATE] = gains.angle_rate**-2
    state += np.diag(angle + turning)
    if gains.integral > 0.0:
        state = block_diag(state, np.eye(_OUTPUTS) / gains.integral**2)
    scale = simulation.command_scale
    return state, np.diag((gains.effort * scale) ** -2.0)


def model(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """A and B of equation (2), with the integrators if there are any."""
    transition, drive, _ = linearise(simulation)
    if gains.integral > 0.0:
        output = simulation.period * output_matrix(simulation.parameters.rod_length)
        transition = np.block([[transition, np.zeros((MODEL_STATE_SIZE, _OUTPUTS))], [output, np.eye(_OUTPUTS)]])
        drive = np.concatenate([drive, np.zeros((_OUTPUTS, drive.shape[1]))])
    return transition, drive


@lru_cache(maxsize=32)
def riccati(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """K and P of equations (1) and (2)."""
    (transition, drive), (state, effort) = model(gains, simulation), weights(gains, simulation)
    cost = solve_discrete_are(transition, drive, state, effort)
    gain = np.linalg.solve(effort + drive.T @ cost @ drive, drive.T @ cost @ transition).astype(np.float64)
    return gain, cost.astype(np.float64)


@dataclass(frozen=True)
class Lqr:
    """The law (1), with integrators if its gains have them."""

    gains: LqrGains
    simulation: Simulation

    def initial_memory(self, rows: int) -> Floats:
        """σ = 0, shape (rows, 3), m·s."""
        return np.zeros((rows, _OUTPUTS))

    def command(self, estimate: Estimate, measurement: Measurement, memory: Floats) -> tuple[Floats, Floats]:
        """Equation (1); see `observed.ControlLaw`."""
        p = self.simulation.parameters
        calm = np.zeros_like(estimate.disturbance)
        flight = flat_outputs.flat_trajectory(measurement.reference, calm, p)
        yaw = estimate.state[:, 8]
        # Roll and pitch are wanted for the heading that there is.
        heading = np.column_stack([yaw, measurement.yaw_reference[:, 1:]])
        state, command = flat_outputs.state_and_command(flight, heading, calm, p)
        state[:, 8] = measurement.yaw_reference[:, 0]
        x = rotate_state((estimate.state - state)[:, STATE_COLUMNS], -yaw)
        x[:, :2] = limit_norm(x[:, :2], self.gains.reach)
        gain, _ = riccati(self.gains, self.simulation)
        command = command - x @ gain[:, :MODEL_STATE_SIZE].T
        if self.gains.integral <= 0.0:
            return command, memory
        command = command - rotate(memory, -yaw, 0) @ gain[:, MODEL_STATE_SIZE:].T
        error = rotate(x @ output_matrix(p.rod_length).T, yaw, 0)
        free = np.isclose(to_action(command, self.simulation)[1], command, atol=1e-3).all(axis=1, keepdims=True)
        bound = self.gains.integral_limit
        return command, np.clip(memory + self.simulation.period * error * free, -bound, bound)
