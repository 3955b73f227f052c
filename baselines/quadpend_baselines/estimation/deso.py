"""The observers of ADRC as an estimator: the measured positions and angles, and the rates and disturbances of chains.

The observers have the chains of `estimation.chains`: Luenberger stages of F_x and F_y, DESOs of F_x⁽⁴⁾ and F_y⁽⁴⁾, of
the height z and of the yaw ψ. They estimate errors relative to the reference, because observations are in single
precision, which represents small numbers with a small absolute error. With K = (M + m_c) g/(M l), the tilt
n = (θ_w, −φ_w) in the axes of the world, and the torques t = (τθ_w, −τφ_w), their outputs and known inputs are

    (1)  F⁽⁴⁾ ≈ F₅ = g K (r_xy − n)                                       (36), (43) corrected
    (2)  F⁽⁶⁾ = u_F + ϑ,     u_F = K F₅ − g K t / I                        (38), (45) corrected
    (3)  z̈ = g_z u + ϑ_z,    g_z = (b_z − m_c/(M+m_c) (r·b) r_z) / M       (18) corrected

where b is the thrust axis. A force d on the quadrotor enters at F⁽⁴⁾ = F₅ + δ with δ = −g d/(M l). The *matched* law
(`AdrcGains.mismatch` = 1) estimates δ where it enters, with one more DESO for x and one for y:

    (4)  y = K (g r_xy − F̈_d),     ÿ = K (F₅ − F_d⁽⁴⁾) + K δ

With the factor K, the disturbance K δ has the unit and the size of ϑ, so that these DESOs have the gains of those of
(2). The same holds for a constant force on the bob, which enters at F̈.

For rigid vehicles, F, r and the parameters are those of the equivalent pendulum (`modelling.equivalent`), and the
tangents r_xy/r_z and b_xy/b_z take the places of r_xy and n, so that (1) and (2) hold at larger tilts. Thrust and
torques in the known inputs are then those that make the accelerations of the nominal model over the period, in which
rotors and on-board loop follow the action that acts; for the paper's vehicle they are those of the action that acts.

To the time when the next action acts, `estimation.prediction` carries the measured state forward, with the rates and
the disturbance of the observers. The observers' states then change as the chains of the state do.

An estimate has the layout of `estimation.estimate`; behind it are 32 states of the observers and the thrust (N) and
torques (N·m) of the latest action that acted on the paper's vehicle.
"""

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

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
    chains_of_state,
    measurement_of_state,
    of_both_axes,
    state_from_chains,
    tilt_rate_of,
)
from quadpend_baselines.estimation.estimate import (
    AGE,
    ANCHOR,
    HELD,
    LOOP,
    MASS_RATIO,
    PLACE,
    POLE,
    REFERENCE,
    RIGID_PART,
    STATE,
    Estimate,
    for_nominal_length,
    is_bounded,
    law_inputs,
    moved,
    near_angle,
    project_direction,
    store_attitude,
    store_measured_reference,
    turned_to,
)
from quadpend_baselines.estimation.estimate import DISTURBANCE as FORCES
from quadpend_baselines.estimation.estimate import YAW as WANTED_YAW
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import observed_rows
from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, design_observers, update_observers
from quadpend_baselines.estimation.prediction import (
    ACTED,
    LoopNumbers,
    Prediction,
    advance,
    move_reference,
    unpack_loop,
)
from quadpend_baselines.estimation.samples import judge, remember
from quadpend_baselines.modelling.equivalent import Pendulum, chain_stiffness, sigma_of
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    calm,
    choose,
    load_reference,
    load_state,
    minus,
    store_vectors,
    turn3,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, dot, load, load_four, scale, store, store_four

BEHIND = OBSERVERS_SIZE + COMMAND_SIZE  # numbers behind those of `estimation.estimate`
_MAX_ESTIMATE = 1e15  # an observer whose states exceed it starts again
_MAX_RATE = 100.0  # rad/s, limit of estimated rates
_MAX_STATE = 1e3  # a predicted state beyond it is not used
WIDTH = 3.0  # see `samples.judge`: a sample is expected where the one before was, since rates can be far off
_FASTEST = 10.0  # m/s, speed above which the rates of an estimate that begins anew are wrong as well
_LEAST_JUMP = 1e-3  # m and rad, of the reference
_MIN_THRUST_GAIN = 0.1  # lower bound of g_z, as a share of 1/(M + m_c)


class BankNumbers(NamedTuple):
    """The observers inside compiled functions, besides their gains."""

    mismatch: float  # see `AdrcGains`
    period: float  # s
    rate_share: float  # share of the error of an angle by which a rate is corrected, 1/s


unpack_bank = unpacker(BankNumbers)


@inlined
def fourth_derivative(m: AdrcMeasurement, model: Pendulum) -> Vec3:
    """Return F₅ of equation (1), m/s⁴."""
    factor = (1.0 - model.pivot_share) * model.physics.gravity * chain_stiffness(model.physics)
    return scale(factor, minus(m.pendulum, m.tilt))


@inlined
def _thrust_gain(m: AdrcMeasurement, model: Pendulum) -> float:
    """Return g_z of equation (3), 1/kg."""
    p, axis, r = model.physics, m.thrust_axis, m.direction
    return (axis.z - p.bob_mass / (p.quadrotor_mass + p.bob_mass) * (dot(r, axis) * r.z)) / p.quadrotor_mass


@inlined
def limited_thrust_gain(m: AdrcMeasurement, model: Pendulum) -> float:
    """Return g_z, at least a tenth of that without a tilt, 1/kg."""
    return max(_thrust_gain(m, model), _MIN_THRUST_GAIN / (model.physics.quadrotor_mass + model.physics.bob_mass))


@inlined
def _acceleration(m: AdrcMeasurement, model: Pendulum) -> Vec3:
    """Return g r_xy − F̈_d of equation (4), m/s²."""
    return minus(scale(model.physics.gravity, sigma_of(m.pendulum, m.tilt, model)), m.reference.d2)


@inlined
def observer_outputs(m: AdrcMeasurement, model: Pendulum) -> tuple[float, ...]:
    """Return the measured output of every observer."""
    fourth, force = minus(fourth_derivative(m, model), m.reference.d4), _acceleration(m, model)
    force = scale(chain_stiffness(model.physics), force)
    return m.error.x, m.error.y, fourth.x, fourth.y, m.error.z, m.yaw_error, force.x, force.y


@inlined
def begin_observers(m: AdrcMeasurement, model: Pendulum, chains: Any, lane: int) -> None:
    """Write the states of the observers at the start of an episode.

    Rates and disturbances are zero, except F̈ = g r_xy and ϑ_z = −g.
    """
    outputs, acceleration = observer_outputs(m, model), _acceleration(m, model)
    for i in range(OBSERVERS_SIZE):
        chains[i, lane] = 0.0
    for i in range(len(outputs)):
        chains[4 * i, lane] = outputs[i]
    chains[LUENBERGER + 2, lane], chains[LUENBERGER + NEXT + 2, lane] = acceleration.x, acceleration.y
    chains[HEIGHT + DISTURBANCE, lane] = -model.physics.gravity


@inlined
def compensated(chains: Any, lane: int, order: int, mismatch: float, model: Pendulum) -> Vec3:
    """Return the part of δ̂ (m/s⁴, order 0) or of its rate (order 1) that is fed back."""
    return scale(mismatch / chain_stiffness(model.physics), of_both_axes(chains, FORCE + DISTURBANCE + order, lane))


@inlined
def observer_inputs(
    m: AdrcMeasurement, chains: Any, lane: int, command: Four, mismatch: float, model: Pendulum
) -> tuple[float, ...]:
    """Return the known input of every observer while a command is applied."""
    p, k, fourth, d = model.physics, chain_stiffness(model.physics), fourth_derivative(m, model), m.reference
    sine, cosine = sincos(m.yaw)
    turning = turn3(Vec3(command.c / p.inertia_pitch, -command.b / p.inertia_roll, 0.0), sine, cosine)
    output = minus(add(fourth, compensated(chains, lane, VALUE, mismatch, model)), d.d4)
    horizontal = minus(axpy(-(p.gravity * k), turning, scale(k, fourth)), d.d6)
    height, yaw = _thrust_gain(m, model) * command.a - d.d2.z, command.d / p.inertia_yaw - d.yaw.z
    force = scale(k, minus(fourth, d.d4))
    return output.x, output.y, horizontal.x, horizontal.y, height, yaw, force.x, force.y


@inlined
def estimated_forces(chains: Any, lane: int, mismatch: float, model: Pendulum) -> Forces:
    """Return the force on the quadrotor (N) and the yaw torque (N·m) of the estimates δ̂ (or ϑ̂/K) and ϑ̂ near hover.

    The other components are zero, because the observers cannot distinguish a force on the bob, and with the paper's law
    a roll or pitch torque, from a force on the quadrotor.
    """
    p, field = model.physics, (FORCE if mismatch > 0.0 else HORIZONTAL) + DISTURBANCE
    arm = p.quadrotor_mass * p.rod_length / (1.0 - model.pivot_share) / (p.gravity * chain_stiffness(p))
    lift = (chains[HEIGHT + DISTURBANCE, lane] + p.gravity) * (p.quadrotor_mass + p.bob_mass)
    force = scale(-arm, of_both_axes(chains, field, lane))
    yaw_torque = chains[YAW + DISTURBANCE, lane] * p.inertia_yaw
    return Forces(Vec3(force.x, force.y, lift), calm().bob_force, Vec3(0.0, 0.0, yaw_torque))


@inlined
def _corrected_rate(measured: VehicleState, predicted: VehicleState, share: float) -> Vec3:
    """Return the predicted rates of the Euler angles, corrected by the error of the predicted angles, rad/s."""
    angle, rate, angles = predicted.euler, predicted.euler_rate, measured.euler
    return Vec3(
        _corrected(angles.x - angle.x, rate.x, share),
        _corrected(angles.y - angle.y, rate.y, share),
        _corrected(angles.z - angle.z, rate.z, share),
    )


@inlined
def _corrected(error: float, rate: float, share: float) -> float:
    turns = np.floor((error + np.pi) / (2.0 * np.pi))
    return float(min(max(rate + share * (error - 2.0 * np.pi * turns), -_MAX_RATE), _MAX_RATE))


@inlined
def advance_known(
    memory: Any, lane: int, action: Four, k: int, loop: LoopNumbers, rigid: RigidSettings | None, buffer: Any
) -> None:
    """Advance an estimate as `prediction` does, and write the thrust and torques that acted behind it."""
    advance(memory, lane, action, k, loop, rigid, buffer)
    store_four(memory, memory.shape[0] - COMMAND_SIZE, lane, load_four(buffer, ACTED, 0))


@inlined
def _known_command(
    before: VehicleState, after: VehicleState, m: AdrcMeasurement, period: float, model: Pendulum, rigid: RigidSettings
) -> Four:
    """Return thrust (N) and torques (N·m) that make the mean accelerations between two states of a rigid vehicle."""
    p = model.physics
    thrust = ((after.velocity.z - before.velocity.z) / period + p.gravity) / limited_thrust_gain(m, model)
    # Mean accelerations of tilt and yaw, as φ, θ and ψ near hover
    first, second = tilt_rate_of(before, before.euler.z, rigid), tilt_rate_of(after, before.euler.z, rigid)
    sine, cosine = sincos(before.euler.z)
    tilt = turn3(minus(second, first), -sine, cosine)
    yaw = (after.euler_rate.z - before.euler_rate.z) / period
    return Four(thrust, p.inertia_roll * -tilt.y / period, p.inertia_pitch * tilt.x / period, p.inertia_yaw * yaw)


@inlined
def _store(
    memory: Any,
    lane: int,
    s: VehicleState,
    mismatch: float,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> None:
    """Write an estimate whose reference is stored, with a state relative to it."""
    s = for_nominal_length(s, -memory[POLE, lane])
    store_vectors(memory, STATE, lane, moved(s, 1.0, memory[PLACE:REFERENCE], lane))
    chains = memory[memory.shape[0] - BEHIND :]
    store_vectors(memory, FORCES, lane, estimated_forces(chains, lane, mismatch, model))
    if rigid is not None:
        store_attitude(memory, lane, s)


@inlined
def _measured(
    memory: Any, lane: int, seen: Any, missing: float, model: Pendulum, rigid: RigidSettings | None
) -> tuple[VehicleState, Derivatives, AdrcMeasurement]:
    """Write the reference of a measurement into an estimate; return the state that laws get, it, and the outputs.

    If the sample is missing, 1 or 0, the state is that of the estimate.
    """
    store_measured_reference(memory, lane, seen)
    reference = load_reference(seen, REFERENCE, lane)
    # From position and place themselves, because small differences of them are exact in single precision
    measured = moved(load_state(seen, STATE, lane), -1.0, seen[PLACE:REFERENCE], lane)
    predicted = moved(load_state(memory, STATE, lane), -1.0, memory[PLACE:REFERENCE], lane)
    s = for_nominal_length(choose(missing > 0.5, predicted, measured), memory[POLE, lane])
    s = turned_to(s, reference.yaw.x)
    return s, reference, measurement_of_state(s, reference, model, rigid)


@inlined
def begin(
    memory: Any,
    lane: int,
    seen: Any,
    has_rates: bool,
    mismatch: float,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> None:
    """Write the estimate at the start of an episode."""
    first = memory.shape[0] - BEHIND
    for i in range(memory.shape[0]):
        memory[i, lane] = 0.0
    memory[MASS_RATIO, lane] = 1.0
    store(memory, ANCHOR, lane, load(seen, PLACE, lane))
    measured, reference, m = _measured(memory, lane, seen, 0.0, model, rigid)
    remember(memory, lane, seen)
    begin_observers(m, model, memory[first:], lane)
    s = state_from_chains(measured, has_rates, reference, m, memory[first:], lane, model, rigid)
    _store(memory, lane, s, mismatch, model, rigid)
    if rigid is not None:
        store_four(memory, RIGID_PART + ROTOR_THRUST, lane, rigid.rotors.hover)


@inlined
def _jumped(change: float) -> float:
    """Return a change of the reference beyond its motion, and 0 for the rounding of the motion."""
    return select(abs(change) > _LEAST_JUMP, change, 0.0)


@inlined
def correct(
    memory: Any,
    lane: int,
    before: Any,
    seen: Any,
    has_rates: bool,
    known: Any,
    bank: Any,
    numbers: BankNumbers,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> None:
    """Correct an estimate in place that was advanced by a period without disturbance and reference.

    `before` is that at the beginning of the period, and `bank` that of `observers.design_observers`. `known` has
    whether the sample is missing (1 or 0; the prediction takes its place), whether the reference may jump (1 or 0), and
    the delay of the sensors in control steps.
    """
    first, held, predicted = memory.shape[0] - BEHIND, load_state(before, STATE, lane), load_state(memory, STATE, lane)
    missing, jumps, sensor_delay = known
    relative, _, wanted = law_inputs(before.T, lane)
    earlier = measurement_of_state(relative, wanted, model, rigid)
    for i in range(MASS_RATIO - PLACE):
        memory[PLACE + i, lane] = before[PLACE + i, lane]
    move_reference(memory, lane, numbers.period)
    place, yaw = load(memory, PLACE, lane), load(memory, WANTED_YAW, lane)
    measured, reference, m = _measured(memory, lane, seen, missing, model, rigid)
    jump = minus(load(memory, PLACE, lane), place)
    turn = reference.yaw.x - (yaw.x + numbers.period * (yaw.y + 0.5 * numbers.period * yaw.z))
    command = load_four(memory, memory.shape[0] - COMMAND_SIZE, lane)
    if rigid is not None:
        command = _known_command(held, predicted, earlier, numbers.period, model, rigid)
    past, chains = before[first:], memory[first:]
    start = observer_inputs(earlier, past, lane, command, numbers.mismatch, model)
    end = observer_inputs(m, past, lane, command, numbers.mismatch, model)
    begin_observers(m, model, chains, lane)
    for i in range(4 * bank.shape[0]):
        chains[i, lane] = past[i, lane]
    chains[LUENBERGER, lane] -= jumps * _jumped(jump.x)
    chains[LUENBERGER + NEXT, lane] -= jumps * _jumped(jump.y)
    chains[HEIGHT, lane] -= jumps * _jumped(jump.z)
    chains[YAW, lane] = near_angle(chains[YAW, lane] - jumps * _jumped(turn), m.yaw_error)
    update_observers(chains, lane, start, end, observer_outputs(m, model), bank, numbers.period)
    memory[AGE, lane] += 1.0
    memory[HELD, lane] *= missing
    is_valid = is_bounded(chains, lane, 4 * bank.shape[0], _MAX_ESTIMATE)
    if sensor_delay > 0:  # a delayed sensor repeats its first sample
        is_valid = is_valid and memory[AGE, lane] > sensor_delay
    if not is_valid:
        begin_observers(m, model, chains, lane)
    s = state_from_chains(measured, has_rates, reference, m, chains, lane, model, rigid)
    if not has_rates:
        rate = _corrected_rate(s, predicted, numbers.rate_share)
        s = VehicleState(s.position, s.velocity, s.euler, rate, s.direction, s.direction_rate)
    _store(memory, lane, s, numbers.mismatch, model, rigid)


@inlined
def begin_anew(
    memory: Any, lane: int, seen: Any, mismatch: float, model: Pendulum, rigid: RigidSettings | None
) -> None:
    """Replace positions and angles of an estimate in place, which went on without a sample, by those of the sample.

    Rates and disturbances stay, unless the vehicle would be faster than `_FASTEST`.
    """
    chains, (s, _, _) = memory[memory.shape[0] - BEHIND :], law_inputs(memory.T, lane)
    kept = select(dot(s.velocity, s.velocity) < _FASTEST * _FASTEST, 1.0, 0.0)
    r, reference, m = _measured(memory, lane, seen, 0.0, model, rigid)
    rates = scale(kept, s.velocity), scale(kept, s.euler_rate), scale(kept, s.direction_rate)
    state = project_direction(VehicleState(r.position, rates[0], r.euler, rates[1], r.direction, rates[2]))
    for i in range(OBSERVERS_SIZE):
        stays = (i > FORCE and i % 4 > 0) or (i > HORIZONTAL and i % 4 > RATE)
        chains[i, lane] = kept * chains[i, lane] if stays else 0.0
    chains_of_state(state, reference, m, model, rigid, 1.0, chains, lane)
    outputs = observer_outputs(m, model)
    for i in range(len(outputs)):
        chains[4 * i, lane] = outputs[i]
    chains[HEIGHT + DISTURBANCE, lane] -= (1.0 - kept) * model.physics.gravity
    _store(memory, lane, state, mismatch, model, rigid)


@compiled
def _observe(
    before: Floats,
    started: Booleans,
    seen: Any,
    bank: Floats,
    packed_bank: Any,
    packed: Any,
    packed_rigid: Any,
    out: Floats,
) -> None:
    """Begin or correct estimates in place that were advanced by a period."""
    lanes, has_rates, doubts = seen[0].T, seen[1], seen[2]
    numbers, plant, memory = unpack_bank(packed_bank), unpack_loop(packed).plant, out.T
    model, rigid = plant.pendulum, None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        if started[row]:
            begin(memory, row, lanes, has_rates, numbers.mismatch, model, rigid)
        else:
            verdict = judge(memory, before.T, row, lanes, numbers.period, doubts, WIDTH)
            known = max(verdict.missing, verdict.begins), doubts, plant.sensor_delay
            correct(memory, row, before.T, lanes, has_rates, known, bank, numbers, model, rigid)
            if verdict.begins > 0.0:
                begin_anew(memory, row, lanes, numbers.mismatch, model, rigid)


@inlined
def shift(now: Any, then: Any, lane: int, model: Pendulum, rigid: RigidSettings | None) -> None:
    """Change the observers of an estimate that was carried forward as the chains of its state do, in place."""
    first = then.shape[0] - BEHIND
    for memory, sign in ((now, -1.0), (then, 1.0)):
        state, _, reference = law_inputs(memory.T, lane)
        m = measurement_of_state(state, reference, model, rigid)
        chains_of_state(state, reference, m, model, rigid, sign, then[first:], lane)


@compiled
def _shift(now: Floats, then: Floats, packed: Any, packed_rigid: Any) -> None:
    model, rigid = unpack_loop(packed).plant.pendulum, None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(then.shape[0]):
        if is_bounded(then.T, row, STATE_SIZE, _MAX_STATE):
            shift(now.T, then.T, row, model, rigid)
        else:
            for i in range(then.shape[1]):
                then[row, i] = now[row, i]


class DesoPrediction(Prediction):
    """The prediction of `estimation.prediction`, with the observers."""

    def carry_forward(self, estimate: Estimate, action: Floats32) -> Estimate:
        """Return the estimate at the time when the next action acts; see `Prediction.carry_forward`."""
        then = super().carry_forward(estimate, action)
        if then is not estimate:
            _shift(estimate.array, then.array, *self.numbers)
        return then


class DesoBank:
    """The observers for n rows.

    Args:
        gains: An `AdrcGains`.
        simulation: Nominal plant and control period.
        loop: The known part of the loop.
    """

    def __init__(self, gains: Any, simulation: Simulation, loop: Loop) -> None:
        self.simulation, self.loop, horizontal = simulation, loop, gains.horizontal
        if gains.predicts:
            self.prediction = DesoPrediction(simulation, loop)
        else:
            self.prediction = DesoPrediction(replace(simulation, latency=0.0), Loop(observation=loop.observation))
        # The driven state and the gains of each observer; only the matched law has the DESOs of the force
        self.observers = [(LUENBERGER_INPUT, gains.luenberger)] * 2 + [(ESO_INPUT, horizontal)] * 2
        self.observers += [(ESO_INPUT, gains.vertical)] * 2 + [(ESO_INPUT, horizontal)] * (2 if gains.mismatch else 0)
        period = simulation.period
        self.bank = BankNumbers(gains.mismatch, period, float(-np.expm1(-horizontal.bandwidth * period) / period))

    @property
    def size(self) -> int:
        """Length of an estimate."""
        return LOOP + self.prediction.loop_size + BEHIND

    @cached_property
    def numbers(self) -> tuple[Floats, Any, Any, Floats | None]:
        """What `_observe` needs besides the observations."""
        return design_observers(self.observers, self.simulation.period), pack(self.bank), *self.prediction.numbers

    def observe(
        self,
        observation: Floats32,
        before: Estimate | None = None,
        action: Floats32 | None = None,
        started: Booleans | None = None,
    ) -> Estimate:
        """Return the estimates after an observation; see `kalman.Estimator.observe`."""
        started, seen = observed_rows(observation, self.loop, self.simulation, before, started)
        last = np.empty((len(observation), self.size)) if before is None else before.array
        out = last.copy()
        if before is not None and action is not None:
            out[:, FORCES:MASS_RATIO] = 0.0  # the accelerations of the nominal model: no disturbance and reference
            out[:, -COMMAND_SIZE:] = self.prediction.advance(out, action)
        _observe(last, started, seen, *self.numbers, out)
        return Estimate(out)
