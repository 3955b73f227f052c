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
vehicle both laws have the estimator of `flatness`; for rigid vehicles they have one of their own.

Dual-mode control switches from one law to the other; here the change is continuous.
"""

from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from quadpend_baselines.controllers.flatness import FlatnessGains, flatness
from quadpend_baselines.controllers.law import Law
from quadpend_baselines.controllers.lqr import LqrGains, deviation, feedback, riccati
from quadpend_baselines.estimation.estimate import Estimate, law_inputs
from quadpend_baselines.gains import EstimatorGains, NotNegative, Scale
from quadpend_baselines.modelling.equivalent import Pendulum, equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.linear_model import model_state
from quadpend_baselines.modelling.quantities import Derivatives, Forces, VehicleState
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import arctan2, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import settings
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.vectors import Four, axpy4, minus4, store_four


@settings
class DualModeGains:
    """Gains of `controllers.dual_mode`."""

    far: FlatnessGains = FlatnessGains()  # far from the reference
    near: LqrGains = LqrGains()  # near it; its reach and estimator are not used
    near_error: Annotated[NotNegative, Scale(-2.5)] = 0.09  # ε₀, m √s: below ε₀ and α₀ only the law near the reference
    far_error: Annotated[NotNegative, Scale(-2.5)] = 0.16  # ε₁, m √s: above ε₁ or α₁ only the law far from it
    near_tilt: NotNegative = 0.15  # α₀, rad
    far_tilt: NotNegative = 0.3  # α₁, rad

    @property
    def estimator(self) -> EstimatorGains:
        """Both laws use the estimates of `far`."""
        return self.far.estimator


unpack_gains = unpacker(DualModeGains)


@inlined
def _fade(value: float, near: float, far: float) -> float:
    """Return 1 below `near`, 0 above `far`, and a linear function in between."""
    return min(max((far - value) / (far - near), 0.0), 1.0)


@inlined
def near_share(s: VehicleState, error: float, gains: Any) -> float:
    """Return s of equation (4) for ε (m √s); the gains have the thresholds of both fades."""
    upright = min(s.direction.z, sincos(s.euler.x)[1] * sincos(s.euler.y)[1])
    tilt = arctan2(np.sqrt(max(1.0 - upright * upright, 0.0)), upright)
    share = _fade(error, gains.near_error, gains.far_error)
    return share * _fade(tilt, gains.near_tilt, gains.far_tilt)


@inlined
def dual_mode(
    s: VehicleState,
    disturbance: Forces,
    reference: Derivatives,
    gains: DualModeGains,
    gain: Any,
    cost: Any,
    period: float,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> Four:
    """Return thrust (N) and torques (N·m) of equation (1); `gain` is K, shape (4, 16), and `cost` P, shape (16, 16)."""
    far = flatness(s, disturbance, reference, gains.far, model, rigid)
    error, command = deviation(s, disturbance, reference, model, rigid)
    x = model_state(error, 0.0, 1.0)
    correction = feedback(x, gain, 0)
    remaining = 0.0
    for i in range(len(x)):
        for j in range(len(x)):
            remaining += x[i] * cost[i, j] * x[j]
    scale = gains.near.position * gains.near.position * period
    share = near_share(s, np.sqrt(scale * max(remaining, 0.0)), gains)
    return axpy4(share, minus4(minus4(command, correction), far), far)


@compiled
def _commands(estimate: Floats, packed: Any, packed_rigid: Floats | None, out: Floats) -> None:
    gain, cost, period = packed[1], packed[2], packed[3]
    gains, pendulum = unpack_gains(packed[0]), unpack_pendulum(packed[4])
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        state, forces, wanted = law_inputs(estimate, row)
        store_four(out.T, 0, row, dual_mode(state, forces, wanted, gains, gain, cost, period, pendulum, rigid))


@dataclass(frozen=True)
class DualMode(Law):
    """The control law (1)–(5) for n rows; `gains.near` has no integrators."""

    gains: DualModeGains
    flies_load = True

    @cached_property
    def _numbers(self) -> tuple[Any, Floats | None]:
        model = equivalent_model(self.simulation)
        gain, cost = (np.ascontiguousarray(matrix) for matrix in riccati(self.gains.near, self.simulation))
        gains = pack(astuple(self.gains))
        return (gains, gain, cost, self.simulation.period, model.packed), model.packed_rigid

    def command(self, estimate: Estimate, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the command of equation (1); see `law.Law`."""
        out = np.empty((len(estimate.array), 4))
        _commands(estimate.array, *self._numbers, out)
        return out, memory
