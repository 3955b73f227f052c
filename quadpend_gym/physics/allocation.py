"""Actions of rigid vehicles that make demanded thrust and torques, for each command interface.

The rotors follow their commands with a lag, and with the interface "body_rates" the on-board loop of
`quadpend_gym.physics.rotors` commands the torques. Both are linear within the limits of the rotors. The action is the
constant one for which, by the nominal model of lag and loop, the mean of thrust and torques over a horizon H equals the
demanded ones:

    (1)  w_c = w + (w_d − w)/(1 − (L/H)(1 − exp(−H/L)))                  thrust and torques; w: present, w_d: demanded
    (2)  ω_c = ω + (α_d − b α)/a,     ω(H) − ω = H (a (ω_c − ω) + b α)   body rates; α = I⁻¹(τ − τ₀ − ω × I ω)

L is the time constant of the rotors. H is the control period, but at least L: a shorter one makes commands that
oscillate from one period to the next. Without lag, (1) is w_c = w_d.
"""

from functools import lru_cache

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST, command_rotors
from quadpend_gym.physics.rigid_settings import make_rigid_settings, pack_rigid, unpack_rigid
from quadpend_gym.physics.rotors import BODY_RATES, ROTOR_THRUSTS, allocate, clip, clip4, thrusts_after, wrench_of
from quadpend_gym.physics.vectors import (
    Vec3,
    add,
    apply,
    axpy,
    axpy4,
    cross,
    inverse,
    load,
    load_four,
    minus4,
    store_four,
)
from quadpend_gym.vehicles import Simulation, hover_wrench


@lru_cache(maxsize=64)
def _design(simulation: Simulation) -> tuple[Floats, Floats, Floats]:
    """Return packed settings, thrust and torques at hover, and the factors of `_response`."""
    hover = hover_wrench(simulation.parameters, simulation.vehicle.pivot)
    return pack_rigid(simulation), hover, np.array(_response(simulation))


def _response(simulation: Simulation) -> tuple[float, float, float]:
    """Return the factor of w_d − w in equation (1), and 1/a (1/s) and b of equation (2)."""
    rotors = simulation.vehicle.rotors
    lag = 0.0 if rotors is None else 0.5 * sum(rotors.lags)
    horizon = max(simulation.period, lag)
    share = 1.0 if lag == 0.0 else 1.0 + lag / horizon * np.expm1(-horizon / lag)
    step = simulation.period / simulation.substeps
    loop, decay = make_rigid_settings(simulation).loop, np.exp(-step / lag) if lag > 0.0 else 0.0
    effects = []
    steps = round(horizon / step)
    for error, acceleration in ((1.0, 0.0), (0.0, 1.0)):  # ω_c − ω and α at the beginning
        remaining = error
        for _ in range(steps):
            wanted = loop.rate_gain * remaining - loop.torque_gain * acceleration
            remaining -= step * wanted + lag * (1.0 - decay) * (acceleration - wanted)
            acceleration = wanted + decay * (acceleration - wanted)
        effects.append((error - remaining) / (steps * step))
    return 1.0 / share, 1.0 / effects[0], effects[1]


@compiled
def _rigid_actions(
    command: Floats, rigid: Floats, packed: Floats, hover: Floats, response: Floats, out: Floats32
) -> None:
    settings = unpack_rigid(packed)
    rotors, scales, inertia = settings.rotors, settings.command_scale, settings.loop.inertia
    per_inertia = inverse(inertia)
    for row in range(command.shape[0]):
        demanded = load_four(command.T, 0, row)
        if rotors.has_rotors > 0.0:
            demanded = wrench_of(allocate(demanded, rotors), rotors)
        else:
            demanded = clip4(demanded, rotors.lowest, rotors.highest)
        thrusts = load_four(rigid.T, ROTOR_THRUST, row)
        now = wrench_of(thrusts, rotors)
        wrench = axpy4(response[0], minus4(demanded, now), now)
        for i in range(4):
            out[row, i] = clip((wrench[i] - hover[i]) / scales[i], -1.0, 1.0)
        if settings.interface == BODY_RATES:
            rate = load(rigid.T, BODY_RATE, row)
            passive = add(settings.trim, cross(rate, apply(inertia, rate)))
            wanted = apply(per_inertia, axpy(-1.0, passive, Vec3(demanded.b, demanded.c, demanded.d)))
            present = apply(per_inertia, axpy(-1.0, passive, Vec3(now.b, now.c, now.d)))
            rates = axpy(response[1], axpy(-response[2], present, wanted), rate)
            for i in range(3):
                out[row, 1 + i] = clip(rates[i] / scales[1 + i], -1.0, 1.0)
        elif settings.interface == ROTOR_THRUSTS:
            wanted_thrusts = allocate(wrench, rotors)
            for i in range(4):
                low, middle, high = rotors.lowest[i], rotors.hover[i], rotors.highest[i]
                change = wanted_thrusts[i] - middle
                out[row, i] = clip(change / (high - middle if change > 0.0 else middle - low), -1.0, 1.0)


def rigid_actions(command: Floats, rigid: Floats, simulation: Simulation) -> Floats32:
    """Return the actions for demanded thrusts (N) and torques (N·m), shape (n, 4).

    The torques are about the body's axes; `rigid` is the memory of the vehicles, shape (n, 11), see `rigid_kernel`.
    """
    out = np.empty(command.shape, np.float32)
    _rigid_actions(np.ascontiguousarray(command), np.ascontiguousarray(rigid), *_design(simulation), out)
    return out


@compiled
def _mean_wrench(
    action: Floats, rate: Floats, thrusts: Floats, packed: Floats, step: float, substeps: int, mean: Floats
) -> None:
    settings = unpack_rigid(packed)
    rotors, inertia, trim = settings.rotors, settings.loop.inertia, settings.trim
    per_inertia = inverse(inertia)
    for row in range(action.shape[0]):
        given, omega = load_four(action.T, 0, row), load(rate.T, 0, row)
        mean[row] = 0.0
        for _ in range(substeps):
            now = load_four(thrusts.T, 0, row)
            wanted = command_rotors(given, now, omega, settings)
            store_four(thrusts.T, 0, row, thrusts_after(now, wanted, rotors.rise.z, rotors.fall.z))
            middle = thrusts_after(now, wanted, rotors.rise.y, rotors.fall.y)
            wrench = wrench_of(middle, rotors)
            for i in range(4):
                mean[row, i] += wrench[i] / substeps
            torque = axpy(-1.0, trim, Vec3(wrench.b, wrench.c, wrench.d))
            turn = apply(per_inertia, axpy(-1.0, cross(omega, apply(inertia, omega)), torque))
            omega = axpy(step, turn, omega)


def mean_wrench(action: Floats | Floats32, rigid: Floats, simulation: Simulation) -> Floats:
    """Return the mean thrust (N) and torques (N·m) of actions over a control period, shape (n, 4).

    The body rate changes by the nominal torques alone, as far as the on-board loop needs it. `rigid` is the memory of
    the vehicles at the beginning, shape (n, 11).
    """
    mean, step = np.empty((len(rigid), 4)), simulation.period / simulation.substeps
    rate, thrusts = rigid[:, BODY_RATE : BODY_RATE + 3].copy(), rigid[:, ROTOR_THRUST : ROTOR_THRUST + 4].copy()
    given = np.asarray(action, np.float64)
    _mean_wrench(given, rate, thrusts, pack_rigid(simulation), step, simulation.substeps, mean)
    return mean
