"""Extended state observer of the whole plant: prediction with the nonlinear simulation, correction with a Kalman gain.

    (1)  predict   x̂⁻ = f(x̂, ā, d̂, μ̂),      d̂⁻ = d̂,   ā_k = h(a_k, a_{k−1}, …)     f: one control period, h: `loop.act`
    (2)  correct   x̂  = x̂⁻ + L_x (y − C x̂⁻),  d̂ = d̂⁻ + L_d (y − C x̂⁻)
    (3)  weight    μ̂ ← μ̂ − ε d̂_z/((M + m) g),   d̂_z ← (1 − ε) d̂_z          ε = 1 − e^(−T/mass_time)

m is the believed mass of the pole; `samples` limits the errors y − C x̂⁻. An estimate is a flat vector, see
`estimate`; `prediction` has equation (1). The extended states d are the forces on quadrotor and bob and the torque,
modelled as random walks. L is the gain of the Kalman filter for model (1) of `linear_model`, rotated by the yaw angle;
the torque on a rigid vehicle is a vector of the world frame. The gain varies over the first steps of an episode, when
the forces and, in output feedback, the rates are unknown; after that it is constant, or with `gust_walk`

    (4)  L = L_calm + s (L_gust − L_calm),     s = min(|d̂_b|²/(0.02 m_b g)², 1)

where d̂_b is the horizontal force on the bob that was estimated before. In turbulence this force fluctuates. Where only
the vehicle is pushed, a filter that expects such fluctuations amplifies the noise of the direction. Drag and constant
wind on the bob raise s too. Between both gains, L is the gain of no Kalman filter, and stability is not proven.

μ̂ is an effective ratio of weight to thrust, relative to the nominal one. Equation (3) attributes every lasting vertical
force to it: other masses, but also slow vertical wind and errors of the thrust. At hover these cannot be distinguished,
but a law that takes the weight of a heavy vehicle for a downward wind overestimates the effect of the tilt on the
pendulum. μ̂ scales the masses of quadrotor and pole, but not the moments of inertia.

While a pendulum with measured rates is more than 72° from upright, x̂ is the measurement; d̂ is still corrected with the
gain of an upright pendulum. The thrusts of the rotors are predicted without correction.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from quadpend_baselines.estimation.estimate import (
    AGE,
    ANCHOR,
    DISTURBANCE,
    HELD,
    INNOVATION,
    LEAST_HEIGHT,
    LOOP,
    MASS_RATIO,
    PLACE,
    POLE,
    REFERENCE,
    RIGID_PART,
    STATE,
    Estimate,
    is_bounded,
    measured_state,
    moved,
    project_direction,
    store_attitude,
    store_measured_reference,
    turned_to,
)
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import observed_rows
from quadpend_baselines.estimation.prediction import BUFFER_SIZE, Prediction, unpack_loop
from quadpend_baselines.estimation.samples import COASTS, full_share, gain_row, judge, remember
from quadpend_baselines.gains import EstimatorGains
from quadpend_baselines.modelling import linear_model
from quadpend_baselines.modelling.equivalent import Pendulum, follow
from quadpend_baselines.modelling.linear_model import (
    MODEL_STATE_SIZE,
    linearise,
    linearise_actions,
    model_state,
    state_of_model,
)
from quadpend_baselines.modelling.quantities import (
    Forces,
    VehicleState,
    calm,
    combine,
    load_forces,
    load_reference,
    load_state,
    store_vectors,
    turn3,
    with_rates,
)
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.state import STATE_SIZE
from quadpend_gym.physics.vectors import Vec3, load, scale, store, store_four

VARYING_STEPS = 100  # corrections after which the gain is constant
MAX_ESTIMATE = 300.0  # SI units, limit of disturbance estimates; a larger state estimate restarts the observer
_LEAST_MASS, _GREATEST_MASS = 0.5, 2.0  # bounds of μ̂
GUST = 0.02  # force on the bob above which equation (4) has the gain of strong wind, share of its weight
_MODEL_PARTS = linear_model.MODEL_FORCE, linear_model.MODEL_BOB_FORCE, linear_model.MODEL_TORQUE
_FORCE, _BOB_FORCE, _TORQUE = (MODEL_STATE_SIZE + part.start for part in _MODEL_PARTS)
# Columns of x that output feedback measures
MEASURED_COLUMNS = np.r_[linear_model.POSITION, linear_model.EULER, linear_model.PENDULUM]
# Standard deviations of the estimates at the start of an episode
_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE = 1.0, 0.1, 0.1  # N, N, N·m
_INITIAL_RATE = 0.1  # of every rate that is not measured, SI units


@inlined
def begin(
    memory: Any,
    lane: int,
    seen: Any,
    has_rates: bool,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> None:
    """Write the estimate at the start of an episode; age and memory of the loop stay as they are.

    The lanes `seen` have the measurement. Rates that are not measured are those of the trajectory that follows the
    reference; the disturbance is zero.
    """
    for i in range(LOOP):
        memory[i, lane] = memory[i, lane] if i == AGE else 0.0
    store(memory, ANCHOR, lane, load(seen, PLACE, lane))
    store_measured_reference(memory, lane, seen)
    remember(memory, lane, seen)
    desired, _, _ = follow(load_reference(seen, REFERENCE, lane), calm(), model)
    rates, measured = moved(desired, 1.0, memory[PLACE:REFERENCE], lane), measured_state(memory, lane, seen)
    state = project_direction(measured if has_rates else with_rates(measured, rates))
    store_vectors(memory, STATE, lane, state)
    memory[MASS_RATIO, lane] = 1.0
    if rigid is not None:
        store_attitude(memory, lane, state)
        store_four(memory, RIGID_PART + ROTOR_THRUST, lane, rigid.rotors.hover)


@inlined
def _corrected(gain: Any, row: int, first: int, x: Any) -> float:
    """Return the product of a row of a gain, which begins with column `first`, and an innovation."""
    total = 0.0
    for j in range(MODEL_STATE_SIZE):
        total += gain[row, first + j] * x[j]
    return total


@inlined
def _limited(e: VehicleState, t: float, doubts: float) -> VehicleState:
    """Return an innovation with what counts of its position, angles and direction, a time t (s) after the last one."""
    position, euler = scale(full_share(0, e.position, t, doubts), e.position), full_share(1, e.euler, t, doubts)
    direction = scale(full_share(2, e.direction, t, doubts), e.direction)
    return VehicleState(position, e.velocity, scale(euler, e.euler), e.euler_rate, direction, e.direction_rate)


@inlined
def correct(
    memory: Any,
    lane: int,
    seen: Any,
    has_rates: bool,
    doubts: float,
    period: float,
    gain: Any,
    mass_share: float,
    p: Parameters,
    rigid: RigidSettings | None,
    buffer: Any,
) -> None:
    """Correct a predicted estimate in place by equations (2) and (3).

    The lanes `seen` have the measurement; `doubts` and the control period are those of `samples.judge`. The gain L has
    the shape (24, 16), or (24, 32) with L_gust − L_calm of equation (4) behind L_calm. The buffer has at least the
    shape (24, 1); `mass_share` is ε of equation (3).
    """
    predicted = load_state(memory, STATE, lane)
    measured = turned_to(measured_state(memory, lane, seen), predicted.euler.z)
    innovation = combine(-1.0, predicted, measured if has_rates else with_rates(measured, predicted))
    store_vectors(memory, INNOVATION, lane, innovation)
    innovation = _limited(innovation, period * (memory[HELD, lane] + 1.0), doubts)
    memory[HELD, lane] = 0.0
    sine, cosine = sincos(predicted.euler.z)
    x, d = model_state(innovation, -sine, cosine), load_forces(memory, DISTURBANCE, lane)
    for i in range(gain.shape[0]):
        buffer[i, 0] = _corrected(gain, i, 0, x)
    if gain.shape[1] > MODEL_STATE_SIZE:
        limit = GUST * p.bob_mass * p.gravity
        share = min((d.bob_force.x * d.bob_force.x + d.bob_force.y * d.bob_force.y) / (limit * limit), 1.0)
        for i in range(gain.shape[0]):
            buffer[i, 0] += share * _corrected(gain, i, MODEL_STATE_SIZE, x)
    state = project_direction(combine(1.0, state_of_model(buffer, sine, cosine), predicted))
    store_vectors(memory, STATE, lane, state)
    force, bob_force = turn3(load(buffer, _FORCE, 0), sine, cosine), turn3(load(buffer, _BOB_FORCE, 0), sine, cosine)
    torque = load(buffer, _TORQUE, 0)
    if rigid is not None:  # a vector of the world frame
        torque = turn3(torque, sine, cosine)
    force_z, ratio = _bounded(d.force.z + force.z), memory[MASS_RATIO, lane]
    weight = (p.quadrotor_mass + p.bob_mass + memory[POLE + 1, lane]) * p.gravity  # believed
    memory[MASS_RATIO, lane] = min(max(ratio - mass_share * force_z / weight, _LEAST_MASS), _GREATEST_MASS)
    force_z += (memory[MASS_RATIO, lane] - ratio) * weight
    memory[AGE, lane] += 1.0
    forces = Forces(
        Vec3(_bounded(d.force.x + force.x), _bounded(d.force.y + force.y), force_z),
        Vec3(_bounded(d.bob_force.x + bob_force.x), _bounded(d.bob_force.y + bob_force.y), d.bob_force.z),
        Vec3(_bounded(d.torque.x + torque.x), _bounded(d.torque.y + torque.y), _bounded(d.torque.z + torque.z)),
    )
    store_vectors(memory, DISTURBANCE, lane, forces)
    store_measured_reference(memory, lane, seen)
    if rigid is not None:
        store_attitude(memory, lane, state)


@inlined
def miss(memory: Any, lane: int, seen: Any) -> None:
    """Go on with a predicted estimate in place without a correction."""
    store_measured_reference(memory, lane, seen)
    for i in range(STATE_SIZE):
        memory[INNOVATION + i, lane] = 0.0


@inlined
def begin_anew(memory: Any, lane: int, seen: Any, rigid: RigidSettings | None) -> None:
    """Replace positions and angles of a predicted estimate in place by those of a measurement."""
    miss(memory, lane, seen)
    predicted = load_state(memory, STATE, lane)
    measured = turned_to(measured_state(memory, lane, seen), predicted.euler.z)
    state = project_direction(with_rates(measured, predicted))
    store_vectors(memory, STATE, lane, state)
    if rigid is not None:
        store_attitude(memory, lane, state)


@inlined
def _bounded(value: float) -> float:
    return min(max(value, -MAX_ESTIMATE), MAX_ESTIMATE)


@compiled
def _observe(
    started: Booleans, seen: Any, table: Floats, mass_share: float, packed: Any, packed_rigid: Any, out: Floats
) -> None:
    """Begin or correct estimates in place that were advanced by a period."""
    loop, memory, buffer = unpack_loop(packed), out.T, np.empty((BUFFER_SIZE, 1))
    lanes, has_rates, doubts = seen[0].T, seen[1], seen[2]
    rigid, model = None if packed_rigid is None else unpack_rigid(packed_rigid), loop.plant.pendulum
    period = loop.parts[0, 0]
    for row in range(out.shape[0]):
        if started[row]:
            for i in range(out.shape[1]):
                out[row, i] = 0.0
            begin(memory, row, lanes, has_rates, model, rigid)
        elif out[row, AGE] < loop.plant.sensor_delay:  # a delayed sensor repeats its first sample
            out[row, AGE] += 1.0
            begin(memory, row, lanes, has_rates, model, rigid)
        else:
            gain = table[gain_row(out[row, AGE], out[row, HELD], table.shape[0])]
            verdict = judge(memory, memory, row, lanes, period, doubts, 1.0)
            if verdict.missing > 0.0:
                miss(memory, row, lanes)
            elif verdict.begins > 0.0:
                begin_anew(memory, row, lanes, rigid)
            else:
                correct(memory, row, lanes, has_rates, doubts, period, gain, mass_share, model.vehicle, rigid, buffer)
            if not is_bounded(memory, row, STATE_SIZE, MAX_ESTIMATE):
                out[row, AGE] = 0.0
                begin(memory, row, lanes, has_rates, model, rigid)
        measured = measured_state(memory, row, lanes)
        if has_rates and measured.direction.z < LEAST_HEIGHT:  # L_x is that of an upright pendulum
            store_vectors(memory, STATE, row, measured)
            if rigid is not None:
                store_attitude(memory, row, measured)


@dataclass(frozen=True)
class Estimator:
    """The observer (1)–(3) for n rows."""

    gains: EstimatorGains  # noise levels of the Kalman filter
    simulation: Simulation  # nominal plant and control period
    loop: Loop = field(default_factory=Loop)  # the known part of the loop

    @cached_property
    def prediction(self) -> Prediction:
        """The prediction (1)."""
        return Prediction(self.simulation, self.loop)

    @property
    def size(self) -> int:
        """Length of an estimate."""
        return LOOP + self.prediction.loop_size

    @cached_property
    def numbers(self) -> tuple[float, Any, Floats | None]:
        """ε, and the numbers of the prediction."""
        time = self.gains.mass_time
        return float(-np.expm1(-self.simulation.period / time)) if time else 0.0, *self.prediction.numbers

    @cached_property
    def tables(self) -> tuple[Floats, Floats]:
        """The gains without and with measured rates, shapes (130, 24, k), see `correct` and `samples.gain_row`.

        The first 100 are those of the first corrections, the last of them also that of all later ones. The others are
        those of the first correction after a coast of 1 to 30 periods.
        """
        gains, gust = self.gains, self.gains.gust_walk
        noise = self.loop.noise if gains.models_loop else (0.0, 0.0, 0.0)

        def table(has_rates: bool) -> Floats:
            calm = _gain_table(gains, self.simulation, has_rates, noise)
            if gust == 0.0:
                return calm
            windy = _gain_table(replace(gains, bob_force_walk=gust), self.simulation, has_rates, noise)
            return np.concatenate([calm, windy - calm], axis=2)

        return table(False), table(True)

    def observe(
        self,
        observation: Floats32,
        before: Estimate | None = None,
        action: Floats32 | None = None,
        started: Booleans | None = None,
    ) -> Estimate:
        """Return the estimates after an observation.

        Args:
            observation: The observation, shape (n, m), laid out as `loop.observation`.
            before: The estimates one period ago; None: the episodes begin with this observation.
            action: The actions since then, shape (n, 4).
            started: The rows whose episode begins with this observation, shape (n,); None: none of them.
        """
        started, seen = observed_rows(observation, self.loop, self.simulation, before, started)
        out = np.empty((len(observation), self.size)) if before is None else before.array.copy()
        if before is not None and action is not None:
            self.prediction.advance(out, action)
        _observe(started, seen, self.tables[self.loop.has_rates], *self.numbers, out)
        return Estimate(out)


@lru_cache(maxsize=32)
def _gain_table(
    gains: EstimatorGains, simulation: Simulation, has_rates: bool, known_noise: tuple[float, float, float]
) -> Floats:
    """Return L of equation (2) for the first 100 corrections, and after coasts, shape (130, 24, 16).

    Columns of rates that are not measured are zero.
    """
    model = linearise_actions(simulation) if gains.models_loop else linearise(simulation)
    states = len(model.transition)  # with the thrusts of the rotors, which are not corrected
    size = states + linear_model.MODEL_DISTURBANCE_SIZE
    is_state, is_disturbance = slice(0, states), slice(states, size)
    transition = np.eye(size)
    transition[is_state, is_state], transition[is_state, is_disturbance] = model.transition, model.disturbance
    walk = _model_disturbance(gains.force_walk, gains.bob_force_walk, gains.torque_walk)
    process = np.diag(np.concatenate([np.zeros(states), walk**2 * simulation.period]))
    by_torque = gains.torque_noise * model.disturbance[:, linear_model.MODEL_TORQUE]
    process[is_state, is_state] += by_torque @ by_torque.T / simulation.period
    noise = np.empty(MODEL_STATE_SIZE)
    fields = linear_model.POSITION, linear_model.EULER, linear_model.PENDULUM
    for columns, known in zip(fields, known_noise, strict=True):
        noise[columns] = max(gains.noise, known) ** 2
    is_rate = np.setdiff1d(np.arange(MODEL_STATE_SIZE), MEASURED_COLUMNS)
    noise[is_rate] = gains.rate_noise**2
    measured = np.arange(MODEL_STATE_SIZE) if has_rates else MEASURED_COLUMNS
    output = np.eye(size)[measured]
    initial_disturbance = _model_disturbance(_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE)
    if gains.models_loop:
        initial_disturbance = walk  # after 1 s
    variance = np.concatenate([noise, np.zeros(states - MODEL_STATE_SIZE), initial_disturbance**2])
    if not has_rates:
        variance[is_rate] = _INITIAL_RATE**2
    covariance = np.diag(variance)
    table = np.zeros((VARYING_STEPS + COASTS, size, MODEL_STATE_SIZE))
    kept = np.r_[:MODEL_STATE_SIZE, states:size]
    for step in range(len(table)):
        predicted = transition @ covariance @ transition.T + process
        gain = np.linalg.solve(output @ predicted @ output.T + np.diag(noise[measured]), output @ predicted).T
        error_transition = np.eye(size) - gain @ output
        corrected = error_transition @ predicted @ error_transition.T + gain @ np.diag(noise[measured]) @ gain.T
        covariance = corrected if step < VARYING_STEPS else predicted
        table[step][:, measured] = gain
    return np.ascontiguousarray(table[:, kept])


def _model_disturbance(force: float, bob_force: float, torque: float) -> Floats:
    """Return one number per component of d in `linear_model`, shape (8,)."""
    out = np.empty(linear_model.MODEL_DISTURBANCE_SIZE)
    for part, value in zip(_MODEL_PARTS, (force, bob_force, torque), strict=True):
        out[part] = value
    return out
