"""Dual-mode control: optimal linear feedback near the reference at small tilts, the flatness-based cascade elsewhere.

    (1)  u = s u_near + (1 − s) u_far
    (2)  u_near = u_d − K (x − x_d)                          `lqr`; x_d and u_d under the estimated disturbance
    (3)  u_far                                               `flatness`
    (4)  s = fade(ε, ε₀, ε₁) · fade(α, α₀, α₁),     fade(a, a₀, a₁) = clip((a₁ − a)/(a₁ − a₀), 0, 1)
    (5)  ε = p √(T (x − x_d)ᵀ P (x − x_d)) ≈ √∫ |e|² dt

K is designed for a small tolerance p of the position error (`near.position`, m), so that it uses most of the range of
the actions. It is optimal for the motion linearised at hover and fails far from there. ε (m √s) is the root of the
integral of the squared tracking error that the feedback (2) would still make in the linear model, by the solution P of
its Riccati equation; T is the control period. α is the larger one of the tilts of pendulum and thrust. For the paper's
vehicle both laws have the gains and the estimator of `flatness`; for rigid vehicles these gains are scaled, and not
tuned (`controllers.vehicle_gains`).

Dual-mode control switches from one law to the other; here the change is continuous.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import deviation, riccati
from quadpend_baselines.estimation.prediction import Estimate, Measurement
from quadpend_baselines.gains import DualModeGains
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State


@dataclass(frozen=True)
class DualMode:
    """The control law (1)–(5); `gains.near` has no integrators."""

    gains: DualModeGains
    simulation: Simulation

    @cached_property
    def far(self) -> Flatness:
        """The control law far from the reference."""
        return Flatness(self.gains.far, self.simulation)

    def initial_memory(self, rows: int) -> tuple[()]:
        """Return an empty tuple: this law has no memory."""
        return ()

    def command(self, estimate: Estimate, measurement: Measurement, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the command of equation (1); see `output_feedback.ControlLaw`."""
        far, _ = self.far.command(estimate, measurement, memory)
        x, near = deviation(estimate, measurement, estimate.disturbance, self.simulation)
        gain, cost = riccati(self.gains.near, self.simulation)
        near = near - _product(x, gain)
        remaining = np.sqrt(np.maximum(np.sum(x * _product(x, cost), axis=1), 0.0))
        error = self.gains.near.position * np.sqrt(self.simulation.period) * remaining
        share = _fade(error, self.gains.near_error, self.gains.far_error)
        share = share * _fade(_tilt(State(estimate.state)), self.gains.near_tilt, self.gains.far_tilt)
        return far + share[:, np.newaxis] * (near - far), memory


def _fade(value: Floats, near: float, far: float) -> Floats:
    """Return 1 below `near`, 0 above `far`, and a linear function in between."""
    return np.clip((far - value) / (far - near), 0.0, 1.0)


def _tilt(state: State) -> Floats:
    """Return the larger one of the tilts of pendulum and thrust, rad, shape (n,)."""
    upright = np.minimum(state.direction[:, 2], np.cos(state.euler[:, 0]) * np.cos(state.euler[:, 1]))
    return np.asarray(np.arccos(np.clip(upright, -1.0, 1.0)))


def _product(x: Floats, matrix: Floats) -> Floats:
    """Return x matrixᵀ; unlike BLAS, with the same bits for one row and many."""
    return np.asarray(np.sum(x[:, np.newaxis] * matrix, axis=-1))
