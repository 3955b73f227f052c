"""Faults of the paper's controller: its laws as printed, and the offset of the corrected ones in steady wind."""

import numpy as np

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.estimation.chains import AdrcMeasurement
from quadpend_baselines.estimation.observers import LUENBERGER_INPUT, chain, current_gain, input_gain
from quadpend_baselines.gains import AdrcGains
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE


class PrintedADRC(ADRC):
    """ADRC with the laws (51) and (52) as printed, valid at ψ = 0: the signs of v in τθ and of τφ are wrong."""

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Return thrust and torques, shape (n, 4)."""
        command, p = super().command(measurement, estimate), self.simulation.parameters
        feedforward = p.inertia_pitch / p.gravity * self.fourth_derivative(measurement)[:, 0]
        command[:, COMMAND_TORQUE + 1] = 2.0 * feedforward - command[:, COMMAND_TORQUE + 1]
        command[:, COMMAND_TORQUE] *= -1.0
        return command


def predicted_offset(gains: AdrcGains, simulation: Simulation) -> float:
    """Return the steady error per newton of a constant force on the quadrotor (m/N) by linear theory.

    The corrected control law neglects w = −g d/(M l) in F⁽⁴⁾ = F₅ + w, both in its feedback and in the input of the
    Luenberger stage, whose error settles at x̃ = (I − L C)(Φ x̃ + Γ w). The offset is (k₄ w + k₀ x̃₁ + … + k₃ x̃₄)/k₀. The
    share of w that `AdrcGains.mismatch` feeds back is subtracted.
    """
    p, period = simulation.parameters, simulation.period
    w = p.gravity / (p.quadrotor_mass * p.rod_length) * (1.0 - gains.mismatch)
    correct = np.eye(4) - np.outer(current_gain(gains.luenberger, period), [1.0, 0.0, 0.0, 0.0])
    bias = np.linalg.solve(np.eye(4) - correct @ chain(period), correct @ input_gain(LUENBERGER_INPUT, period) * w)
    k = ADRC(gains, simulation).horizontal_gains
    return float((k[4] * w + k[:4] @ bias) / k[0])
