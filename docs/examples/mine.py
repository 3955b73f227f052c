"""An LQR with integral action and feed-forward: a controller of your own in about thirty lines.

quadpend evaluate mine:MyController flatness adrc-paper --scenarios calm windy
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from quadpend_baselines.estimation.measurement import measurement_from_observation
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, linearise, rotate, rotate_state
from quadpend_baselines.policy.protocol import episode_start_mask, to_action

# Tolerances of position, velocity, angles, angular rates, pendulum and its rate, and the integral (Bryson's rule)
TOLERANCES = np.repeat([0.05, 0.2, 0.3, 1.0, 0.3, 1.0, 0.02], [3, 3, 3, 3, 2, 2, 3])


class MyController:
    layouts = ("full",)  # fields that it reads: a scenario must observe them

    def __init__(self, simulation):
        self.simulation, self.rod = simulation, simulation.parameters.rod_length
        A, B, _ = linearise(simulation)  # at hover, over one control period
        C = np.zeros((3, 16))  # tracking error of (F_x, F_y, z)
        C[:, :3], C[[0, 1], [12, 13]] = np.eye(3), self.rod
        A = np.block([[A, np.zeros((16, 3))], [simulation.period * C, np.eye(3)]])
        B = np.vstack([B, np.zeros((3, 4))])
        Q, R = np.diag(TOLERANCES**-2.0), np.diag((0.3 * simulation.command_scale) ** -2.0)
        P = solve_discrete_are(A, B, Q, R)
        self.gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        measured = measurement_from_observation(np.atleast_2d(observation), self.rod)
        yaw, rows = measured.state[:, 8], len(measured.state)
        started = episode_start_mask(episode_start, state is None, rows)[:, np.newaxis]
        integral = np.where(started, 0.0, np.zeros((rows, 3)) if state is None else state)  # m·s, world frame
        calm = np.zeros((rows, 9))  # the feed-forward knows the reference, but not the wind
        model = equivalent_model(self.simulation)
        desired, command = model.trajectory(measured.reference, measured.yaw, calm)
        error = rotate_state((measured.state - desired)[:, STATE_COLUMNS], -yaw)
        command = command - np.hstack([error, rotate(integral, -yaw, 0)]) @ self.gain.T
        tracking = measured.state[:, :3] + self.rod * measured.state[:, 12:15] * [1.0, 1.0, 0.0]
        integral = np.clip(integral + self.simulation.period * tracking, -0.5, 0.5)
        action = to_action(command, self.simulation)  # N and N·m to [-1, 1]
        return (action[0] if np.ndim(observation) == 1 else action), integral
