"""ADRC with extended state observers for yaw, height and both horizontal channels: the paper's controller, corrected.

The controller measures positions and angles only: the tracking error e of the flat outputs, the direction r of the
pendulum, and the attitude. With K = (M + m_c) g/(M l), the tilt n = (θ_w, −φ_w) in the axes of the world, and the
torques t = (τθ_w, −τφ_w):

    (1)  F⁽⁴⁾ ≈ F₅ = g K (r_xy − n)                                       (36), (43) corrected
    (2)  F⁽⁶⁾ = u_F + ϑ,     u_F = K F₅ − g K t / I                        (38), (45) corrected
    (3)  v = F_d⁽⁶⁾ − Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) − ϑ̂,   t = (I/g) F₅ − (I/(g K)) v     (51), (52) corrected
    (4)  u = (z̈_d − k₁ ė̂_z − k₀ ê_z − ϑ̂_z) / g_z,   g_z = (b_z − m_c/(M+m_c) (r·b) r_z) / M    (23), (18) corrected
    (5)  τψ = I_ψ (ψ̈_d − k₁ ė̂_ψ − k₀ ê_ψ − ϑ̂_ψ)                            (16)

where b is the thrust axis. The observers estimate errors relative to the reference, because observations are in single
precision, which represents small numbers with a small absolute error.

A force d on the quadrotor enters at F⁽⁴⁾ = F₅ + δ with δ = −g d/(M l), which the paper's control law neglects. The
*matched* law (`AdrcGains.mismatch` = 1) estimates δ where it enters, with one more DESO for x and one for y:

    (6)  y = K (g r_xy − F̈_d),     ÿ = K (F₅ − F_d⁽⁴⁾) + K δ

With the factor K, the disturbance K δ has the unit and the size of ϑ, so that these DESOs have the gains of those of
(2). The law uses F₅ + δ̂ for F⁽⁴⁾ in (3) and in the Luenberger stage, and the derivative of F₅ + δ̂ for F⁽⁵⁾. The same
holds for a constant force on the bob, which enters at F̈. By (1) and (2), ϑ = K δ + g K (t/I − n̈): ϑ also contains the
difference between the nominal angular acceleration and the true one: errors of the inertia, the rate loop and the gyro.
So the law subtracts ϑ̂ in (3), but does not take ϑ̂/K for δ̂, which a biased gyro makes an estimate of a false force.

The paper assumes ψ → 0. This implementation rotates roll and pitch by ψ into the axes of the world (n and t above),
which makes no difference at ψ = 0.

For rigid vehicles, F, r and the parameters in (1) to (3) are those of the equivalent pendulum (`modelling.equivalent`),
and the tangents r_xy/r_z and b_xy/b_z take the places of r_xy and n, so that (1) and (2) hold at larger tilts. Thrust
and torques in the known inputs of the observers are then those that make the accelerations of the nominal model over
the period, in which rotors and on-board loop follow the action that acts.

Over the known delays and lags of the loop, and over the latency, `estimation.prediction` carries the measured state
forward, with the rates and the disturbance of the observers and the commands under way. The observers' states change as
the chains of the state do (`estimation.chains`). Equations (3) to (5) then give the command for the predicted state.
"""

from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.estimation.chains import (
    DISTURBANCE,
    FORCE,
    HEIGHT,
    HORIZONTAL,
    LUENBERGER,
    NEXT,
    OBSERVERS_SIZE,
    RATE,
    VALUE,
    YAW,
    AdrcMeasurement,
    attitude_accelerations,
    chains_of_state,
    measurement_of_state,
    of_both_axes,
    read_measurement,
    state_from_chains,
    tilt_rate_of,
)
from quadpend_baselines.estimation.estimate import (
    AGE,
    LOOP,
    MASS_RATIO,
    REFERENCE,
    RIGID_PART,
    is_bounded,
    law_inputs,
    store_attitude,
)
from quadpend_baselines.estimation.estimate import DISTURBANCE as PLANT_DISTURBANCE
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import measure
from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, design_observers, update_observers
from quadpend_baselines.estimation.prediction import (
    BUFFER_SIZE,
    Prediction,
    advance,
    carry_forward,
    load_action,
    unpack_loop,
)
from quadpend_baselines.gains import Bandwidth, Damping, ObserverGains, Scale
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    body_command,
    chain_stiffness,
    equivalent_model,
    sigma_of,
    unpack_pendulum,
)
from quadpend_baselines.modelling.quantities import (
    Forces,
    VehicleState,
    calm,
    divide,
    load_state,
    minus,
    store_vectors,
    turn3,
)
from quadpend_baselines.policy.protocol import episode_start_mask, to_action, to_command
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.physics.rigid_kernel import RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, dot, load_four, scale, store_four
from quadpend_gym.tasks.observation import (
    OUTPUT_FEEDBACK_COLUMNS,
    OUTPUT_FEEDBACK_SIZE,
)


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


_MAX_ESTIMATE = 1e15  # an observer whose states exceed it starts again
_MAX_RATE = 100.0  # rad/s, limit of estimated rates
_MAX_STATE = 1e3  # a predicted state beyond it is not used
_MIN_THRUST_GAIN = 0.1  # lower bound of g_z, as a share of 1/(M + m_c)
# First fields of the memory, an array of shape (n, k): states of the observers; thrust (N) and torques (N·m) that act
# after the latest observation; the action; the observation without rates. For rigid vehicles, and in a loop with known
# delays or lags, two estimates follow (`estimation.prediction`): the latest measured state, and this one a control
# period later, predicted. The thrust and the torques are then the mean ones that the nominal model predicts.
COMMAND, ACTION, OBSERVED = OBSERVERS_SIZE, OBSERVERS_SIZE + 4, OBSERVERS_SIZE + 8
PLANT = OBSERVED + OUTPUT_FEEDBACK_SIZE


class AdrcNumbers(NamedTuple):
    """The feedback inside compiled functions."""

    k0: float  # k₀ … k₅ of equation (3)
    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    vertical_k0: float  # k₀ and k₁ of equations (4) and (5)
    vertical_k1: float
    mismatch: float  # see `AdrcGains`
    period: float  # s
    rate_share: float  # share of the error of an angle by which a rate is corrected, 1/s


unpack_numbers = unpacker(AdrcNumbers)


@inlined
def fourth_derivative(m: AdrcMeasurement, model: Pendulum) -> Vec3:
    """Return F₅ of equation (1), m/s⁴."""
    factor = (1.0 - model.pivot_share) * model.physics.gravity * chain_stiffness(model.physics)
    return scale(factor, minus(m.pendulum, m.tilt))


@inlined
def thrust_gain(m: AdrcMeasurement, model: Pendulum) -> float:
    """Return g_z of equation (4), 1/kg."""
    p, axis, r = model.physics, m.thrust_axis, m.direction
    return (axis.z - p.bob_mass / (p.quadrotor_mass + p.bob_mass) * (dot(r, axis) * r.z)) / p.quadrotor_mass


@inlined
def _limited_thrust_gain(m: AdrcMeasurement, model: Pendulum) -> float:
    return max(thrust_gain(m, model), _MIN_THRUST_GAIN / (model.physics.quadrotor_mass + model.physics.bob_mass))


@inlined
def _acceleration(m: AdrcMeasurement, model: Pendulum) -> Vec3:
    """Return g r_xy − F̈_d of equation (6), m/s²."""
    return minus(scale(model.physics.gravity, sigma_of(m.pendulum, m.tilt, model)), m.reference.d2)


@inlined
def observer_outputs(m: AdrcMeasurement, model: Pendulum) -> tuple[float, ...]:
    """Return the measured output of every observer."""
    fourth, force = minus(fourth_derivative(m, model), m.reference.d4), _acceleration(m, model)
    force = scale(chain_stiffness(model.physics), force)
    return m.error.x, m.error.y, fourth.x, fourth.y, m.error.z, m.yaw_error, force.x, force.y


@inlined
def begin(m: AdrcMeasurement, model: Pendulum, estimate: Any, lane: int) -> None:
    """Write the states of the observers at the start of an episode.

    Rates and disturbances are zero, except F̈ = g r_xy and ϑ_z = −g.
    """
    outputs, acceleration = observer_outputs(m, model), _acceleration(m, model)
    estimate[:OBSERVERS_SIZE, lane] = 0.0
    for i in range(len(outputs)):
        estimate[4 * i, lane] = outputs[i]
    estimate[LUENBERGER + 2, lane], estimate[LUENBERGER + NEXT + 2, lane] = acceleration.x, acceleration.y
    estimate[HEIGHT + DISTURBANCE, lane] = -model.physics.gravity


@inlined
def _compensated(estimate: Any, lane: int, order: int, numbers: AdrcNumbers, model: Pendulum) -> Vec3:
    """Return the part of δ̂ (m/s⁴, order 0) or of its rate (order 1) that is fed back."""
    share = numbers.mismatch / chain_stiffness(model.physics)
    return scale(share, of_both_axes(estimate, FORCE + DISTURBANCE + order, lane))


@inlined
def adrc(m: AdrcMeasurement, estimate: Any, lane: int, numbers: AdrcNumbers, model: Pendulum) -> Four:
    """Return thrust (N) and torques (N·m) by equations (3)–(5), before saturation."""
    p, k, fourth = model.physics, chain_stiffness(model.physics), fourth_derivative(m, model)
    value = _compensated(estimate, lane, VALUE, numbers, model)
    rate = _compensated(estimate, lane, RATE, numbers, model)
    x = _feedback(estimate, lane, 0, value.x, rate.x, numbers)
    y = _feedback(estimate, lane, NEXT, value.y, rate.y, numbers)
    virtual_input = minus(m.reference.d6, Vec3(x, y, 0.0))  # v
    sine, cosine = sincos(m.yaw)
    heading = turn3(divide(minus(scale(k, fourth), virtual_input), p.gravity * k), -sine, cosine)
    lift = m.reference.d2.z - _vertical_feedback(estimate, lane, HEIGHT, numbers)
    yaw = m.reference.yaw.z - _vertical_feedback(estimate, lane, YAW, numbers)
    thrust = lift / _limited_thrust_gain(m, model)
    return Four(thrust, p.inertia_roll * -heading.y, p.inertia_pitch * heading.x, p.inertia_yaw * yaw)


@inlined
def _feedback(estimate: Any, lane: int, axis: int, value: float, rate: float, numbers: AdrcNumbers) -> float:
    """Return Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) + ϑ̂ of the axis whose observers begin `axis` fields after those of x."""
    stage, eso = LUENBERGER + axis, HORIZONTAL + axis
    return float(
        numbers.k0 * estimate[stage, lane]
        + numbers.k1 * estimate[stage + 1, lane]
        + numbers.k2 * estimate[stage + 2, lane]
        + numbers.k3 * estimate[stage + 3, lane]
        + numbers.k4 * (estimate[eso + VALUE, lane] + value)
        + numbers.k5 * (estimate[eso + RATE, lane] + rate)
        + estimate[eso + DISTURBANCE, lane]
    )


@inlined
def _vertical_feedback(estimate: Any, lane: int, eso: int, numbers: AdrcNumbers) -> float:
    """Return k₁ ė̂ + k₀ ê + ϑ̂ of height (4) or yaw (5)."""
    position, rate = estimate[eso + VALUE, lane], estimate[eso + RATE, lane]
    return float(numbers.vertical_k0 * position + numbers.vertical_k1 * rate + estimate[eso + DISTURBANCE, lane])


@inlined
def observer_inputs(
    m: AdrcMeasurement, estimate: Any, lane: int, command: Four, numbers: AdrcNumbers, model: Pendulum
) -> tuple[float, ...]:
    """Return the known input of every observer while a command is applied."""
    p, k, fourth, d = model.physics, chain_stiffness(model.physics), fourth_derivative(m, model), m.reference
    sine, cosine = sincos(m.yaw)
    turning = turn3(Vec3(command.c / p.inertia_pitch, -command.b / p.inertia_roll, 0.0), sine, cosine)
    output = minus(add(fourth, _compensated(estimate, lane, VALUE, numbers, model)), d.d4)
    horizontal = minus(axpy(-(p.gravity * k), turning, scale(k, fourth)), d.d6)
    height, yaw = thrust_gain(m, model) * command.a - d.d2.z, command.d / p.inertia_yaw - d.yaw.z
    force = scale(k, minus(fourth, d.d4))
    return output.x, output.y, horizontal.x, horizontal.y, height, yaw, force.x, force.y


@inlined
def estimated_forces(estimate: Any, lane: int, numbers: AdrcNumbers, model: Pendulum) -> Forces:
    """Return the force on the quadrotor (N) and the yaw torque (N·m) of the estimates δ̂ (or ϑ̂/K) and ϑ̂ near hover."""
    p, field = model.physics, (FORCE if numbers.mismatch > 0.0 else HORIZONTAL) + DISTURBANCE
    arm = p.quadrotor_mass * p.rod_length / (1.0 - model.pivot_share) / (p.gravity * chain_stiffness(p))
    lift = (estimate[HEIGHT + DISTURBANCE, lane] + p.gravity) * (p.quadrotor_mass + p.bob_mass)
    force = scale(-arm, of_both_axes(estimate, field, lane))
    yaw_torque = estimate[YAW + DISTURBANCE, lane] * p.inertia_yaw
    return Forces(Vec3(force.x, force.y, lift), calm().bob_force, Vec3(0.0, 0.0, yaw_torque))


@compiled
def _observe(
    last: Any, seen: Any, bank: Floats, packed: Floats, packed_loop: Any, packed_rigid: Any, out: Floats
) -> None:
    """Write the observers' states after an observation, and its part without rates."""
    observation, has_rates = seen
    (before, started), numbers, plant, memory = last, unpack_numbers(packed), unpack_loop(packed_loop).plant, out.T
    model, rigid = plant.pendulum, None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        for i in range(OUTPUT_FEEDBACK_SIZE):
            out[row, OBSERVED + i] = observation[row, OUTPUT_FEEDBACK_COLUMNS[i] if has_rates else i]
        m = read_measurement(memory, OBSERVED, row, model, rigid)
        begin(m, model, memory, row)
        if started[row]:
            continue
        for i in range(4 * bank.shape[0]):
            out[row, i] = before[row, i]
        command, seen = load_four(before.T, COMMAND, row), read_measurement(before.T, OBSERVED, row, model, rigid)
        first = observer_inputs(seen, before.T, row, command, numbers, model)
        second = observer_inputs(m, before.T, row, command, numbers, model)
        update_observers(memory, row, first, second, observer_outputs(m, model), bank, numbers.period)
        is_valid = is_bounded(memory, row, 4 * bank.shape[0], _MAX_ESTIMATE)
        if plant.sensor_delay > 0:  # a delayed sensor repeats its first sample
            following = PLANT + (out.shape[1] - PLANT) // 2
            is_valid = is_valid and before[row, following + AGE] > plant.sensor_delay
        if not is_valid:
            begin(m, model, memory, row)


@compiled
def _disturbances(memory: Floats, packed: Floats, packed_model: Floats, out: Floats) -> None:
    numbers, model = unpack_numbers(packed), unpack_pendulum(packed_model)
    for row in range(out.shape[0]):
        store_vectors(out.T, 0, row, estimated_forces(memory.T, row, numbers, model))


@inlined
def _corrected_rate(measured: VehicleState, predicted: VehicleState, numbers: AdrcNumbers) -> Vec3:
    """Return the predicted rates of the Euler angles, corrected by the error of the predicted angles, rad/s."""
    angle, rate, angles = predicted.euler, predicted.euler_rate, measured.euler
    return Vec3(
        _corrected(angles.x - angle.x, rate.x, numbers.rate_share),
        _corrected(angles.y - angle.y, rate.y, numbers.rate_share),
        _corrected(angles.z - angle.z, rate.z, numbers.rate_share),
    )


@inlined
def _corrected(error: float, rate: float, share: float) -> float:
    turns = np.floor((error + np.pi) / (2.0 * np.pi))
    return float(min(max(rate + share * (error - 2.0 * np.pi * turns), -_MAX_RATE), _MAX_RATE))


@compiled
def _commands(
    last: Any, seen: Any, packed: Floats, packed_loop: Any, packed_rigid: Any, out: Floats, later: Floats
) -> Floats:
    """Return the commands, by the estimates at the time when the action acts (`later`) if the memory contains some."""
    (before, started), numbers, loop = last, unpack_numbers(packed), unpack_loop(packed_loop)
    observation, has_rates = seen
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    model, size, buffer = loop.plant.pendulum, later.shape[1], np.empty((BUFFER_SIZE, 1))
    chains, command = np.empty((OBSERVERS_SIZE, 1)), np.empty((out.shape[0], ACTION_SIZE))
    for row in range(out.shape[0]):
        m = read_measurement(out.T, OBSERVED, row, model, rigid)
        if size == 0:
            store_four(command.T, 0, row, adrc(m, out.T, row, numbers, model))
            continue
        now, kept = out[:, PLANT : PLANT + size].T, before[:, PLANT + size : PLANT + 2 * size].T
        given, reference = measure(observation.T, row, has_rates, model.vehicle.rod_length)
        s = state_from_chains(given, has_rates, reference, m, out.T, row, model, rigid)
        if not (started[row] or has_rates):
            rate = _corrected_rate(s, load_state(kept, 0, row), numbers)
            s = VehicleState(s.position, s.velocity, s.euler, rate, s.direction, s.direction_rate)
        chosen = Four(0.0, 0.0, 0.0, 0.0)
        for i in range(size):
            now[i, row] = 0.0 if started[row] or (i < LOOP and i != AGE) else kept[i, row]
        if not started[row]:
            chosen = load_four(before.T, ACTION, row)
        store_vectors(now, 0, row, s)
        store_vectors(now, REFERENCE, row, reference)
        now[MASS_RATIO, row] = 1.0
        if rigid is not None:
            store_attitude(now, RIGID_PART, row, s)
            thrusts = rigid.rotors.hover
            if not started[row]:
                thrusts = load_four(kept, RIGID_PART + ROTOR_THRUST, row)
            store_four(now, RIGID_PART + ROTOR_THRUST, row, thrusts)

        for i in range(size):
            later[row, i] = now[i, row]
        for i in range(OBSERVERS_SIZE):
            chains[i, 0] = out[row, i]
        then = later.T
        store_vectors(then, PLANT_DISTURBANCE, row, estimated_forces(out.T, row, numbers, model))
        if loop.parts.shape[0] > 1:
            carry_forward(then, row, chosen, loop, rigid, buffer)
            if is_bounded(then, row, STATE_SIZE, _MAX_STATE):
                state, _, ahead = law_inputs(later, row)
                present = measurement_of_state(s, reference, model, rigid)
                chains_of_state(s, reference, present, model, rigid, -1.0, chains, 0)
                m = measurement_of_state(state, ahead, model, rigid)
                chains_of_state(state, ahead, m, model, rigid, 1.0, chains, 0)
            else:
                later[row] = now[:, row]
        state, p, demanded = load_state(then, 0, row), model.physics, adrc(m, chains, 0, numbers, model)
        turning = Vec3(demanded.b / p.inertia_roll, demanded.c / p.inertia_pitch, demanded.d / p.inertia_yaw)
        turning = attitude_accelerations(state, turning, rigid)
        demanded = Four(demanded.a, p.inertia_roll * turning.x, p.inertia_pitch * turning.y, p.inertia_yaw * turning.z)
        store_four(command.T, 0, row, body_command(state, demanded, calm(), model, rigid))
    return command


@compiled
def _apply(action: Floats32, packed: Floats, packed_loop: Any, packed_rigid: Any, out: Floats) -> None:
    """Write action, predicted plant and mean command for the case that these actions are applied."""
    numbers, loop, buffer = unpack_numbers(packed), unpack_loop(packed_loop), np.empty((BUFFER_SIZE, 1))
    rigid, model = None if packed_rigid is None else unpack_rigid(packed_rigid), loop.plant.pendulum
    size, p = (out.shape[1] - PLANT) // 2, model.physics
    for row in range(out.shape[0]):
        now, following = out[:, PLANT : PLANT + size].T, out[:, PLANT + size :].T
        chosen = load_action(action, row)
        store_four(out.T, ACTION, row, chosen)
        for i in range(size):
            following[i, row] = 0.0 if REFERENCE <= i < MASS_RATIO else now[i, row]
        advance(following, row, chosen, 0, loop, rigid, buffer)
        before, after = load_state(now, 0, row), load_state(following, 0, row)
        m = read_measurement(out.T, OBSERVED, row, model, rigid)
        thrust = ((after.velocity.z - before.velocity.z) / numbers.period + p.gravity) / _limited_thrust_gain(m, model)
        # Mean accelerations of tilt and yaw, as φ, θ and ψ near hover
        first, second = tilt_rate_of(before, before.euler.z, rigid), tilt_rate_of(after, before.euler.z, rigid)
        sine, cosine = sincos(before.euler.z)
        tilt = turn3(minus(second, first), -sine, cosine)
        yaw = (after.euler_rate.z - before.euler_rate.z) / numbers.period
        roll, pitch = -tilt.y / numbers.period, tilt.x / numbers.period
        command = Four(thrust, p.inertia_roll * roll, p.inertia_pitch * pitch, p.inertia_yaw * yaw)
        store_four(out.T, COMMAND, row, command)


class ADRC(Controller):
    """The paper's controller as a policy with the `predict` protocol.

    Args:
        gains, simulation, loop: As of `Controller`.
    """

    gains: AdrcGains

    def __init__(self, gains: Any, simulation: Simulation | None = None, loop: Loop | None = None) -> None:
        super().__init__(gains, simulation, loop)
        self.model, gains = equivalent_model(self.simulation), self.gains
        self._prediction = Prediction(self.simulation, self.loop if gains.predicts else Loop(), gains.predicts)
        # The driven state and the gains of each observer
        self.observers: list[tuple[Any, ObserverGains]] = [
            (LUENBERGER_INPUT, gains.luenberger),
            (LUENBERGER_INPUT, gains.luenberger),
            (ESO_INPUT, gains.horizontal),
            (ESO_INPUT, gains.horizontal),
            (ESO_INPUT, gains.vertical),
            (ESO_INPUT, gains.vertical),
        ]
        if gains.mismatch:
            self.observers += [(ESO_INPUT, gains.horizontal), (ESO_INPUT, gains.horizontal)]
        # k₀ … k₅ and k₀, k₁: the coefficients of (s² + 2ζωs + ω²)³ and of s² + 2ζωs + ω², lowest power first
        horizontal = [1.0, 2.0 * gains.damping * gains.horizontal_bandwidth, gains.horizontal_bandwidth**2]
        vertical = [1.0, 2.0 * gains.damping * gains.vertical_bandwidth, gains.vertical_bandwidth**2]
        self.horizontal_gains = np.polymul(np.polymul(horizontal, horizontal), horizontal)[:0:-1]
        period = self.simulation.period
        rate_share = -np.expm1(-gains.horizontal.bandwidth * period) / period
        feedback = (*self.horizontal_gains, *vertical[:0:-1], gains.mismatch, period, rate_share)
        self.numbers = AdrcNumbers._make(map(float, feedback))
        self._packed = pack(self.numbers)

    @cached_property
    def _bank(self) -> Floats:
        return design_observers(self.observers, self.simulation.period)

    @cached_property
    def _estimate_size(self) -> int:
        """Length of an estimate of the plant in the memory; 0 if the actions do not depend on it.

        They depend on the vehicle's attitude and rotors, or on the commands under way.
        """
        needed = self.model.packed_rigid is not None or self._prediction.loop_size > 0
        return LOOP + self._prediction.loop_size if needed else 0

    def act(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, Floats]:
        """Return actions and memory; see `Controller.act`."""
        self.loop.observation.check(observation)
        rows, size, seen = len(observation), self._estimate_size, (observation, self.loop.has_rates)
        memory, later = np.empty((rows, PLANT + 2 * size)), np.empty((rows, size))
        last = memory if state is None else state, episode_start_mask(episode_start, state is None, rows)
        _observe(last, seen, self._bank, self._packed, *self._prediction.numbers, memory)
        command = self.command(last, seen, memory, later)
        if not size:
            action = to_action(command, self.simulation)
        else:
            wanted = to_action(command, self.simulation, later[:, RIGID_PART : RIGID_PART + RIGID_SIZE])
            action = np.nan_to_num(self._prediction.compensate(wanted, later))
        self._apply(memory, action)
        return action, memory

    def command(self, last: Any, seen: Any, memory: Floats, later: Floats) -> Floats:
        """Return thrust (N) and torques (N·m) by equations (3)–(5), before saturation, shape (n, 4)."""
        return _commands(last, seen, self._packed, *self._prediction.numbers, memory, later)

    def _apply(self, memory: Floats, action: Floats32) -> None:
        if self._estimate_size:
            _apply(action, self._packed, *self._prediction.numbers, memory)
        else:
            memory[:, COMMAND:ACTION], memory[:, ACTION:OBSERVED] = to_command(action, self.simulation), action

    def with_applied_action(self, memory: Floats, action: Floats32) -> Floats:
        """Return the memory for the case that `action`, shape (n, 4), is applied instead of the controller's action."""
        out = memory.copy()
        self._apply(out, action)
        return out

    def estimated_disturbance(self, memory: Floats) -> Floats:
        """Return the estimated disturbance in the layout of ``info["disturbance"]``, N and N·m, shape (n, 9).

        Near hover, the estimates δ̂ (with the paper's law ϑ̂/K) and ϑ̂ are converted to a force on the quadrotor (world
        frame) and a yaw torque. The other components are zero, because the observers cannot distinguish a force on the
        bob, and with the paper's law a roll or pitch torque, from a force on the quadrotor.
        """
        out = np.empty((len(memory), DISTURBANCE_SIZE))
        _disturbances(memory, self._packed, self.model.packed, out)
        return out
