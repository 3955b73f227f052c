"""ADRC with extended state observers for yaw, height and both horizontal channels: the paper's controller, corrected.

The controller measures positions and angles only: the tracking error e of the flat outputs, the direction r of the
pendulum, and the attitude. From the estimates of `estimation.deso`, whose symbols these are, it computes

    (1)  v = F_d⁽⁶⁾ − Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) − ϑ̂,   t = (I/g) F₅ − (I/(g K)) v     (51), (52) corrected
    (2)  u = (z̈_d − k₁ ė̂_z − k₀ ê_z − ϑ̂_z) / g_z                                   (23) corrected
    (3)  τψ = I_ψ (ψ̈_d − k₁ ė̂_ψ − k₀ ê_ψ − ϑ̂_ψ)                                     (16)

The paper's control law neglects that a force on the quadrotor enters at F⁽⁴⁾ = F₅ + δ. The *matched* law
(`AdrcGains.mismatch` = 1) uses F₅ + δ̂ for F⁽⁴⁾ in (1) and in the Luenberger stage, and the derivative of F₅ + δ̂ for
F⁽⁵⁾. Since ϑ = K δ + g K (t/I − n̈), ϑ also contains the difference between the nominal angular acceleration and the
true one: errors of the inertia, the rate loop and the gyro. So the law subtracts ϑ̂ in (1), but does not take ϑ̂/K for
δ̂, which a biased gyro makes an estimate of a false force.

The paper assumes ψ → 0. This implementation rotates roll and pitch by ψ into the axes of the world (n and t above),
which makes no difference at ψ = 0. Equations (1) to (3) give the command for the state that is predicted over the
known delays and lags of the loop, and over the latency.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.law import Law
from quadpend_baselines.estimation.chains import (
    DISTURBANCE,
    HEIGHT,
    HORIZONTAL,
    LUENBERGER,
    NEXT,
    RATE,
    VALUE,
    YAW,
    AdrcMeasurement,
    attitude_accelerations,
    measurement_of_state,
)
from quadpend_baselines.estimation.deso import (
    BEHIND,
    DesoBank,
    compensated,
    fourth_derivative,
    limited_thrust_gain,
)
from quadpend_baselines.estimation.estimate import Estimate, law_inputs
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.gains import Bandwidth, Damping, ObserverGains, Scale
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    body_command,
    chain_stiffness,
    equivalent_model,
    unpack_pendulum,
)
from quadpend_baselines.modelling.quantities import calm, divide, minus, turn3
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.vectors import Four, Vec3, scale, store_four


@settings
class AdrcGains:
    """Gains of ADRC.

    The defaults are those of the paper's Section 5, not tuned. Where the paper gives no values, this project chooses
    them: a saturation replaces the sign term (`ObserverGains`), with ρ above the largest |ϑ̈| of this project's winds,
    so that the observers rarely leave the boundary layer; the sampling period is 10 ms, and the observers use the mean
    of the known inputs over it (`estimation.observers`); the torques are limited.
    """

    horizontal_bandwidth: Bandwidth = 7.0  # ω_nc of F_x and F_y, Section 5
    vertical_bandwidth: Bandwidth = 10.0  # ω_nc of height z and yaw ψ, Section 5
    damping: Damping = 0.9  # ζ_c of all channels, Section 5
    luenberger: ObserverGains = ObserverGains()  # of F … F⁽³⁾, (46)
    horizontal: Annotated[ObserverGains, Scale(6, of="switching")] = ObserverGains(switching=5e6)  # of F⁽⁴⁾ …, ϑ, (47)
    vertical: Annotated[ObserverGains, Scale(2, of="switching")] = ObserverGains(
        switching=1e4
    )  # of z and ψ, (13), (20)
    # Share of the estimate δ̂ in F⁽⁴⁾, and of its rate in F⁽⁵⁾; 0: the paper's law, without δ̂
    mismatch: Annotated[float, Range(0.0, 10.0)] = 0.0
    predicts: bool = True  # whether known delays and lags of the loop are predicted through


class AdrcNumbers(NamedTuple):
    """The feedback inside compiled functions."""

    k0: float  # k₀ … k₅ of equation (1)
    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    vertical_k0: float  # k₀ and k₁ of equations (2) and (3)
    vertical_k1: float
    mismatch: float  # see `AdrcGains`


unpack_numbers = unpacker(AdrcNumbers)


@inlined
def adrc(m: AdrcMeasurement, chains: Any, lane: int, numbers: AdrcNumbers, model: Pendulum) -> Four:
    """Return thrust (N) and torques (N·m) near hover by equations (1)–(3), before saturation."""
    p, k, fourth = model.physics, chain_stiffness(model.physics), fourth_derivative(m, model)
    value = compensated(chains, lane, VALUE, numbers.mismatch, model)
    rate = compensated(chains, lane, RATE, numbers.mismatch, model)
    x = _feedback(chains, lane, 0, value.x, rate.x, numbers)
    y = _feedback(chains, lane, NEXT, value.y, rate.y, numbers)
    virtual_input = minus(m.reference.d6, Vec3(x, y, 0.0))  # v
    sine, cosine = sincos(m.yaw)
    heading = turn3(divide(minus(scale(k, fourth), virtual_input), p.gravity * k), -sine, cosine)
    lift = m.reference.d2.z - _vertical_feedback(chains, lane, HEIGHT, numbers)
    yaw = m.reference.yaw.z - _vertical_feedback(chains, lane, YAW, numbers)
    thrust = lift / limited_thrust_gain(m, model)
    return Four(thrust, p.inertia_roll * -heading.y, p.inertia_pitch * heading.x, p.inertia_yaw * yaw)


@inlined
def _feedback(chains: Any, lane: int, axis: int, value: float, rate: float, numbers: AdrcNumbers) -> float:
    """Return Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) + ϑ̂ of the axis whose observers begin `axis` fields after those of x."""
    stage, eso = LUENBERGER + axis, HORIZONTAL + axis
    return float(
        numbers.k0 * chains[stage, lane]
        + numbers.k1 * chains[stage + 1, lane]
        + numbers.k2 * chains[stage + 2, lane]
        + numbers.k3 * chains[stage + 3, lane]
        + numbers.k4 * (chains[eso + VALUE, lane] + value)
        + numbers.k5 * (chains[eso + RATE, lane] + rate)
        + chains[eso + DISTURBANCE, lane]
    )


@inlined
def _vertical_feedback(chains: Any, lane: int, eso: int, numbers: AdrcNumbers) -> float:
    """Return k₁ ė̂ + k₀ ê + ϑ̂ of height (2) or yaw (3)."""
    position, rate = chains[eso + VALUE, lane], chains[eso + RATE, lane]
    return float(numbers.vertical_k0 * position + numbers.vertical_k1 * rate + chains[eso + DISTURBANCE, lane])


@inlined
def command_of(estimate: Any, row: int, numbers: AdrcNumbers, model: Pendulum, rigid: RigidSettings | None) -> Four:
    """Return thrust (N) and torques (N·m) about the axes of the body for an estimate of `deso`."""
    (state, _, reference), p = law_inputs(estimate, row), model.physics
    m = measurement_of_state(state, reference, model, rigid)
    demanded = adrc(m, estimate.T[estimate.shape[1] - BEHIND :], row, numbers, model)
    turning = Vec3(demanded.b / p.inertia_roll, demanded.c / p.inertia_pitch, demanded.d / p.inertia_yaw)
    turning = attitude_accelerations(state, turning, rigid)
    demanded = Four(demanded.a, p.inertia_roll * turning.x, p.inertia_pitch * turning.y, p.inertia_yaw * turning.z)
    return body_command(state, demanded, calm(), model, rigid)


@compiled
def _commands(estimate: Floats, packed: Any, packed_pendulum: Any, packed_rigid: Any, out: Floats) -> None:
    numbers, model = unpack_numbers(packed), unpack_pendulum(packed_pendulum)
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        store_four(out.T, 0, row, command_of(estimate, row, numbers, model, rigid))


@dataclass(frozen=True)
class AdrcLaw(Law):
    """The control law (1)–(3) for n rows. Networks on it read the measured state, not an estimate."""

    gains: AdrcGains
    observer = "deso"

    def estimator(self, loop: Loop) -> DesoBank:
        """Return the observers."""
        return DesoBank(self.gains, self.simulation, loop)

    @cached_property
    def numbers(self) -> AdrcNumbers:
        """The feedback; k₀ … k₅ and k₀, k₁ are the coefficients of (s² + 2ζωs + ω²)³ and of s² + 2ζωs + ω²."""
        gains = self.gains
        horizontal, vertical = (
            [1.0, 2.0 * gains.damping * bandwidth, bandwidth**2]
            for bandwidth in (gains.horizontal_bandwidth, gains.vertical_bandwidth)
        )
        cubed = np.polymul(np.polymul(horizontal, horizontal), horizontal)
        return AdrcNumbers._make(map(float, (*cubed[:0:-1], *vertical[:0:-1], gains.mismatch)))

    @cached_property
    def _packed(self) -> tuple[Any, Any, Floats | None]:
        model = equivalent_model(self.simulation)
        return pack(self.numbers), model.packed, model.packed_rigid

    def command(self, estimate: Estimate, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the command of equations (1)–(3); see `law.Law`."""
        out = np.empty((len(estimate.array), 4))
        _commands(estimate.array, *self._packed, out)
        return np.nan_to_num(out), memory
