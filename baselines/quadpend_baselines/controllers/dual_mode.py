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
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.flatness import FlatnessNumbers, flatness, pack_gains, unpack_gains
from quadpend_baselines.controllers.lqr import deviation, feedback, riccati
from quadpend_baselines.estimation.prediction import Estimate, Measurement, law_inputs
from quadpend_baselines.gains import DualModeGains
from quadpend_baselines.modelling.equivalent import Pendulum, equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.linear_model import model_state
from quadpend_baselines.modelling.quantities import Derivatives, Forces, VehicleState
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import arctan2, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.vectors import Four, store_four


class DualModeNumbers(NamedTuple):
    """The limits of equation (4) inside compiled functions, see `DualModeGains`."""

    near_error: float
    far_error: float
    near_tilt: float
    far_tilt: float
    scale: float  # p² T of equation (5), m² s


unpack_numbers = unpacker(DualModeNumbers)


@inlined
def _fade(value: float, near: float, far: float) -> float:
    """Return 1 below `near`, 0 above `far`, and a linear function in between."""
    return min(max((far - value) / (far - near), 0.0), 1.0)


@inlined
def dual_mode(
    s: VehicleState,
    disturbance: Forces,
    reference: Derivatives,
    gains: FlatnessNumbers,
    gain: Any,
    cost: Any,
    numbers: DualModeNumbers,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> Four:
    """Return thrust (N) and torques (N·m) of equation (1).

    Args:
        s: State, with position and velocity relative to the reference.
        disturbance: Disturbance, N and N·m.
        reference: The reference.
        gains: Gains of the law far from the reference.
        gain: K of the law near it, shape (4, 16).
        cost: P, shape (16, 16).
        numbers: Limits of the change.
        model: The equivalent pendulum.
        rigid: Settings of a rigid vehicle; None: the paper's vehicle.
    """
    far = flatness(s, disturbance, reference, Four(1.0, 1.0, 1.0, 1.0), gains, model, rigid)
    error, command = deviation(s, disturbance, reference, model, rigid)
    x = model_state(error, 0.0, 1.0)
    correction = feedback(x, gain, 0)
    remaining = 0.0
    for i in range(len(x)):
        for j in range(len(x)):
            remaining += x[i] * cost[i, j] * x[j]
    upright = min(s.direction.z, sincos(s.euler.x)[1] * sincos(s.euler.y)[1])
    tilt = arctan2(np.sqrt(max(1.0 - upright * upright, 0.0)), upright)
    share = _fade(np.sqrt(numbers.scale * max(remaining, 0.0)), numbers.near_error, numbers.far_error)
    share = share * _fade(tilt, numbers.near_tilt, numbers.far_tilt)
    return Four(
        far.a + share * (command.a - correction.a - far.a),
        far.b + share * (command.b - correction.b - far.b),
        far.c + share * (command.c - correction.c - far.c),
        far.d + share * (command.d - correction.d - far.d),
    )


@compiled
def _commands(
    estimate: Floats, measurement: Measurement, packed: Any, packed_rigid: Floats | None, out: Floats
) -> None:
    far, gain, cost = unpack_gains(packed[0]), packed[1], packed[2]
    limits, pendulum = unpack_numbers(packed[3]), unpack_pendulum(packed[4])
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        state, forces, wanted = law_inputs(estimate, measurement, row)
        store_four(out.T, 0, row, dual_mode(state, forces, wanted, far, gain, cost, limits, pendulum, rigid))


@dataclass(frozen=True)
class DualMode:
    """The control law (1)–(5) for n rows; `gains.near` has no integrators."""

    gains: DualModeGains
    simulation: Simulation

    @cached_property
    def _numbers(self) -> tuple[Any, Floats | None]:
        g, model = self.gains, equivalent_model(self.simulation)
        scale = g.near.position**2 * self.simulation.period
        limits = pack(DualModeNumbers(g.near_error, g.far_error, g.near_tilt, g.far_tilt, scale))
        gain, cost = (np.ascontiguousarray(matrix) for matrix in riccati(g.near, self.simulation))
        return (pack_gains(g.far), gain, cost, limits, model.packed), model.packed_rigid

    def initial_memory(self, rows: int) -> tuple[()]:
        """Return an empty tuple: this law has no memory."""
        return ()

    def command(self, estimate: Estimate, measurement: Measurement, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the command of equation (1); see `output_feedback.ControlLaw`."""
        out = np.empty((len(estimate.array), 4))
        _commands(estimate.array, measurement, *self._numbers, out)
        return out, memory
