"""LQR and LQI: optimal linear feedback around the trajectory that follows the reference.

    (1)  u = u_d − K (x − x_d),   K = (R + BᵀPB)⁻¹ BᵀPA       P: discrete algebraic Riccati equation
    (2)  J = ½ Σ (x_kᵀ Q x_k + u_kᵀ R u_k) = ½ x₀ᵀ P x₀

x and u are those of `linear_model`, rotated into the axes of the heading. x_d and u_d are the trajectory of
`flat_outputs` without wind. Q weights the errors of the flat outputs e = (ζ_x + l r_x, ζ_y + l r_y, ζ_z), their rates,
roll, pitch, yaw and the angular rates. Each weight is the inverse square of a tolerance (Bryson's rule).

For rigid vehicles, x_d and u_d are those of the equivalent pendulum (`modelling.equivalent`), and A and B are those of
the rigid body with its pivot and drag.

LQI appends the integrals σ_{k+1} = σ_k + T e_k to x. It integrates only while the command is within the limits of the
actuators (anti-windup), and each component of σ is bounded. The norm of the horizontal position error is limited to
`LqrGains.reach`, because linear feedback of a larger error would tilt the pendulum so far that it falls.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from quadpend_baselines.estimation.prediction import Estimate, Measurement
from quadpend_baselines.gains import LqrGains
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import (
    EULER,
    EULER_RATE,
    HORIZONTAL_POSITION,
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
from quadpend_gym.physics.state import State

_OUTPUTS = 3


def output_matrix(rod_length: float) -> Floats:
    """Return C of e = C x, shape (3, 16)."""
    out = np.zeros((_OUTPUTS, MODEL_STATE_SIZE))
    out[:, POSITION] = np.eye(_OUTPUTS)
    out[:2, PENDULUM] = rod_length * np.eye(2)
    return out


@lru_cache(maxsize=32)
def weights(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return Q and R of equation (2), shapes (16, 16), or (19, 19) with integrators, and (4, 4)."""
    output = output_matrix(simulation.parameters.rod_length)
    output_rate = np.zeros_like(output)
    output_rate[:, VELOCITY], output_rate[:, PENDULUM_RATE] = output[:, POSITION], output[:, PENDULUM]
    state = output.T @ output / gains.position**2 + output_rate.T @ output_rate / gains.velocity**2
    angle, angle_rate = np.zeros(MODEL_STATE_SIZE), np.zeros(MODEL_STATE_SIZE)
    angle[EULER] = gains.angle**-2
    angle_rate[EULER_RATE] = gains.angle_rate**-2
    state += np.diag(angle + angle_rate)
    if gains.integral > 0.0:
        state = block_diag(state, np.eye(_OUTPUTS) / gains.integral**2)
    return state, np.diag((gains.effort * equivalent_model(simulation).simulation.command_scale) ** -2.0)


def model(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return A and B of the model for which the gain K is designed, including the integrators of LQI."""
    transition, input_matrix, _ = linearise(simulation)
    if gains.integral > 0.0:
        output = simulation.period * output_matrix(simulation.parameters.rod_length)
        transition = np.block([[transition, np.zeros((MODEL_STATE_SIZE, _OUTPUTS))], [output, np.eye(_OUTPUTS)]])
        input_matrix = np.concatenate([input_matrix, np.zeros((_OUTPUTS, input_matrix.shape[1]))])
    return transition, input_matrix


@lru_cache(maxsize=32)
def riccati(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return K of equation (1) and P of equation (2)."""
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    P = solve_discrete_are(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A).astype(np.float64)
    return gain, P.astype(np.float64)


def varying_gains(A: Floats, B: Floats, Q: Floats, R: Floats, P: Floats) -> Floats:
    """Return the gains K_k of the regulator along a flight of N control steps, shape (N, m, n).

    K_k = (R + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ P_{k+1} A_k,    P_k = Q + A_kᵀ P_{k+1} (A_k − B_k K_k),    P_N = P
    """
    gains = np.empty((len(A), B.shape[2], A.shape[1]))
    for k in range(len(A) - 1, -1, -1):
        gains[k] = np.linalg.solve(R + B[k].T @ P @ B[k], B[k].T @ P @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ gains[k])
        P = 0.5 * (P + P.T)
    return gains


def deviation(
    estimate: Estimate, measurement: Measurement, disturbance: Floats, simulation: Simulation
) -> tuple[Floats, Floats]:
    """Return x − x_d in the axes of the heading, shape (n, 16), SI units, and u_d, shape (n, 4), N and N·m.

    x_d and u_d follow the reference under the given disturbance, N and N·m, shape (n, 9).
    """
    yaw = State(estimate.state).euler[:, 2]
    # The desired roll and pitch are computed for the actual heading, not for the desired one.
    heading = np.column_stack([yaw, measurement.yaw_reference[:, 1:]])
    equivalent = equivalent_model(simulation)
    state, command = equivalent.trajectory(measurement.reference, heading, disturbance)
    command = equivalent.body_command(state, command, disturbance)
    State(state).euler[:, 2] = measurement.yaw_reference[:, 0]
    return rotate_state((estimate.state - state)[:, STATE_COLUMNS], -yaw), command


@dataclass(frozen=True)
class Lqr:
    """The control law (1), with integrators if `gains.integral` is positive."""

    gains: LqrGains
    simulation: Simulation

    def initial_memory(self, rows: int) -> Floats:
        """Return σ = 0, shape (rows, 3), m·s."""
        return np.zeros((rows, _OUTPUTS))

    def command(self, estimate: Estimate, measurement: Measurement, memory: Floats) -> tuple[Floats, Floats]:
        """Return the command of equation (1) and the integrals σ; see `output_feedback.ControlLaw`."""
        p, yaw = self.simulation.parameters, State(estimate.state).euler[:, 2]
        x, command = deviation(estimate, measurement, np.zeros_like(estimate.disturbance), self.simulation)
        x[:, HORIZONTAL_POSITION] = limit_norm(x[:, HORIZONTAL_POSITION], self.gains.reach)
        gain, _ = riccati(self.gains, self.simulation)
        command = command - x @ gain[:, :MODEL_STATE_SIZE].T
        if self.gains.integral <= 0.0:
            return command, memory
        command = command - rotate(memory, -yaw, 0) @ gain[:, MODEL_STATE_SIZE:].T
        error = rotate(x @ output_matrix(p.rod_length).T, yaw, 0)
        applied = to_action(command, self.simulation)[1]
        unsaturated = np.isclose(applied, command, atol=1e-3).all(axis=1, keepdims=True)
        limit = self.gains.integral_limit
        return command, np.clip(memory + self.simulation.period * error * unsaturated, -limit, limit)
