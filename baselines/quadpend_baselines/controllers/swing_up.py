"""Swing-up along a planned flight, which hands over to a balancing controller.

A row is in one of three phases:

- *damp*: the pendulum is brought to rest below the quadrotor, from any direction. With a lift that equals the weight, a
  horizontal force f changes the energy e = |ṙ|²/2 + K r_z by ė = −f·ṙ/(M l), so

      (1)  f = (M + m_c)(q v − k ζ − d ζ̇),    limited to the lean λ_max

  damps it; v is the horizontal part of ṙ after the lead time τ, which makes up for the time that the attitude needs.
  The thrust is the lift over max(b_z, 0.3), times min(max(b_z, 0)/0.95, 1)², with the vertical component b_z of the
  thrust axis. So a vehicle that is thrown in any attitude first turns its thrust axis upwards. Beyond a tilt of 18° the
  thrust is reduced, and (1) holds only roughly.
- *swing*: the planned flight x_k, a_k of one of the files `PLANS` is flown with the feedback of a time-varying
  linear-quadratic regulator (`lqr.varying_gains`), with A_k and B_k along the plan, and Q, R and P_N of `lqr`:

      (2)  a = a_k − K_k (x − x_k)

  x is the state relative to the reference, in the axes of the reference's heading. The regulator neglects the lag of
  rotors.
- *balance*: `flatness` balances the pendulum at the reference.

Damping ends when the pendulum hangs almost at rest. At the end of the plan, and while damping, balancing begins if it
can catch the pendulum: at |r_xy + ṙ_xy/√K| < c, the unstable mode of an upright pendulum, above the height
r_z = `catch_height`. It ends below `lost_height`. The plan is for a reference at rest, and for a loop without delays.
Direct multiple shooting has found it (`swing_up_planner` of version 0.3): it minimises the actions and the distance of
the centre of mass from the reference, with actions up to 0.8 and a pitch up to 65°, which leaves room for the feedback.
"""

from dataclasses import replace
from enum import IntEnum
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers import lqr
from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import LqrGains
from quadpend_baselines.controllers.output_feedback import OutputFeedback, OutputFeedbackMemory
from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import measurement_from_observation
from quadpend_baselines.gains import Angle, Bandwidth, Damping, NotNegative, Positive, Scale, gains_for
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, jacobian, limit_norm, rotate
from quadpend_baselines.policy.protocol import episode_start_mask, to_action
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
    POSITION,
    STATE_SIZE,
    VELOCITY,
    State,
)
from quadpend_gym.tasks.observation import FULL
from quadpend_gym.vehicles import VEHICLES

PLANS = {  # the files of the plans, and what they are for
    Path(__file__).with_name("swing_up.csv"): Simulation(),
    Path(__file__).with_name("swing_up_hummingbird.csv"): Simulation(VEHICLES["hummingbird"], "body_rates"),
}

# What "almost at rest" means: lengths of r_xy (1), ṙ (1/s), position (m) and velocity (m/s) relative to the reference,
# roll and pitch (rad), and the rates of the attitude (rad/s).
_AT_REST = (0.15, 1.0, 0.5, 0.3, 0.15, 0.5)
_UPRIGHT = 0.95  # vertical component of the thrust axis from which on the thrust has its full size
_LEAST_VERTICAL = 0.3  # lower bound of the vertical component of the thrust axis, and of the lift in units of g


@settings
class SwingUpGains:
    """Gains of `controllers.swing_up`, and the limits of the region in which the balancing controller takes over."""

    damp: Annotated[Positive, Scale(-1)] = 0.336  # q, m/s, of damping the swing
    lead: Annotated[NotNegative, Scale(-1)] = 0.0521  # τ, s
    position: Annotated[NotNegative, Scale(2)] = 2.65  # k, 1/s²
    velocity: Annotated[NotNegative, Scale(1)] = 4.5  # d, 1/s
    lean: Angle = 0.596  # λ_max
    attitude_bandwidth: Bandwidth = 15.0  # of roll and pitch while damping
    vertical_bandwidth: Bandwidth = 3.61  # of height and yaw while damping
    damping: Damping = 0.892  # of both
    # Of the time-varying regulator; set by hand
    regulator: LqrGains = LqrGains(position=0.2, velocity=1.0, angle=1.4, angle_rate=4.0)
    catch: Positive = 0.347  # c
    catch_height: Annotated[float, Range(-1.0, 1.0)] = 0.745  # r_z
    lost_height: Annotated[float, Range(-1.0, 1.0)] = 0.4  # r_z; set by hand
    rest_scale: Positive = 1.02  # factor on the limits of "almost at rest" in `controllers.swing_up`


class Phase(IntEnum):
    """What a row does."""

    DAMP = 0
    SWING = 1
    BALANCE = 2


class SwingUpMemory(NamedTuple):
    """Memory of `SwingUp` for n rows."""

    phase: Integers  # `Phase`, shape (n,)
    step: Integers  # control step of the plan, shape (n,)
    balancing: OutputFeedbackMemory  # memory of the balancing controller


class SwingUp(Controller):
    """Damping, a planned flight and a balancing controller as a policy."""

    gains: SwingUpGains
    layouts = (FULL,)

    def __init__(self, gains: Any, simulation: Simulation | None = None, loop: Loop | None = None) -> None:
        super().__init__(gains, simulation, loop)
        self.balancer = OutputFeedback(Flatness, gains_for("flatness", self.simulation), self.simulation, loop)

    def act(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, SwingUpMemory]:
        """Return actions and memory; see `Controller.act`."""
        measurement = measurement_from_observation(observation, self.simulation.parameters.rod_length)
        rows = len(observation)
        phase, step = np.full(rows, Phase.DAMP), np.zeros(rows, np.int64)
        if state is not None:
            continues = ~episode_start_mask(episode_start, False, rows)
            phase, step = np.where(continues, state.phase, phase), np.where(continues, state.step + 1, step)
        balanced = phase == Phase.BALANCE
        phase, step = self._next_phase(State(measurement.state), phase, step)
        balances = phase == Phase.BALANCE
        memory = None if state is None else state.balancing
        balancing, memory = self.balancer.predict(observation, memory, ~(balances & balanced))
        action = self._damp(State(measurement.state), measurement)
        action[balances] = balancing[balances]
        swings = phase == Phase.SWING
        if swings.any():
            action[swings] = self._swing(measurement, step)[swings]
        return action, SwingUpMemory(phase, step, memory)

    def _next_phase(self, s: State, phase: Integers, step: Integers) -> tuple[Integers, Integers]:
        """Return the phase and the step of the plan after the latest measurement."""
        swings = phase == Phase.SWING
        if swings.any():
            swings &= step < len(tracked_plan(self.gains, self.simulation).actions)
        balances = (phase == Phase.BALANCE) & (s.direction[:, 2] >= self.gains.lost_height)
        phase = np.where(swings | balances, phase, Phase.DAMP)
        phase = np.where((phase == Phase.DAMP) & self._can_catch(s), Phase.BALANCE, phase)
        begins = (phase == Phase.DAMP) & self._rests(s)
        if begins.any() and (self.loop.steps or self.loop.lags):
            raise ValueError("swing-up has a plan for a loop without delays and lags only")
        return np.where(begins, Phase.SWING, phase), np.where(begins, 0, step)

    def _can_catch(self, s: State) -> Booleans:
        """Return whether the balancing controller can catch the pendulum, shape (n,)."""
        rate = np.sqrt(equivalent_model(self.simulation).parameters.chain_stiffness)
        mode = np.linalg.norm(s.direction[:, :2] + s.direction_rate[:, :2] / rate, axis=1)
        return np.asarray((mode < self.gains.catch) & (s.direction[:, 2] > self.gains.catch_height))

    def _rests(self, s: State) -> Booleans:
        """Return whether the pendulum hangs almost at rest near the reference, shape (n,)."""
        parts = s.direction[:, :2], s.direction_rate, s.position, s.velocity, s.euler[:, :2], s.euler_rate
        small = [
            np.linalg.norm(part, axis=1) < self.gains.rest_scale * limit
            for part, limit in zip(parts, _AT_REST, strict=True)
        ]
        return np.asarray(np.all(small, axis=0) & (s.direction[:, 2] < 0.0))

    def _swing(self, measurement: Estimate, step: Integers) -> Floats32:
        """Return the actions of equation (2), shape (n, 4)."""
        plan = tracked_plan(self.gains, self.simulation)
        k = np.minimum(step, len(plan.actions) - 1)
        heading = measurement.yaw[:, 0]
        x = rotate(measurement.state, -heading, POSITION, VELOCITY, DIRECTION, DIRECTION_RATE)
        State(x).euler[:, 2] -= heading
        deviation = (x - plan.states[k])[:, np.newaxis]
        action = plan.actions[k] - np.sum(plan.gains[k] * deviation, axis=-1)
        return np.asarray(np.clip(action, -1.0, 1.0), np.float32)

    def _damp(self, s: State, measurement: Estimate) -> Floats32:
        """Return the actions of equation (1), shape (n, 4)."""
        p, gains, r, rate = self.simulation.parameters, self.gains, s.direction, s.direction_rate
        along = p.chain_stiffness * r[:, 2] - np.sum(rate**2, axis=1)  # r̈ without f: `along` times r, horizontally
        later = rate[:, :2] + gains.lead * along[:, np.newaxis] * r[:, :2]
        push = gains.damp * later - gains.position * s.position[:, :2] - gains.velocity * s.velocity[:, :2]
        w = gains.vertical_bandwidth
        lift = p.gravity - 2.0 * gains.damping * w * s.velocity[:, 2] - w * w * s.position[:, 2]
        lift = np.maximum(lift, _LEAST_VERTICAL * p.gravity)
        tangent = limit_norm(push / lift[:, np.newaxis], np.tan(gains.lean))
        vertical = np.cos(s.euler[:, 0]) * np.cos(s.euler[:, 1])
        share = np.clip(vertical / _UPRIGHT, 0.0, 1.0) ** 2  # less thrust while it points sideways, none downwards
        thrust = p.total_mass * lift * share / np.maximum(vertical, _LEAST_VERTICAL)
        command = np.column_stack([thrust, self._torques(s, measurement, tangent)])
        return to_action(command, self.simulation, plant_of(self.simulation).initial_memory(measurement.state))

    def _torques(self, s: State, measurement: Estimate, tangent: Floats) -> Floats:
        """Return the torques that turn the thrust axis towards a direction with a tangent, N·m, shape (n, 3)."""
        p, gains = self.simulation.parameters, self.gains
        forward, lateral = rotate(tangent, -s.euler[:, 2], 0).T
        pitch = np.arctan(forward)
        wanted = np.column_stack([-np.arctan(lateral * np.cos(pitch)), pitch, measurement.yaw[:, 0]])
        bandwidth = np.array([gains.attitude_bandwidth, gains.attitude_bandwidth, gains.vertical_bandwidth])
        acceleration = -2.0 * gains.damping * bandwidth * s.euler_rate - bandwidth**2 * (s.euler - wanted)
        return np.asarray(np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw]) * acceleration)


class TrackedPlan(NamedTuple):
    """The planned flight of the package, of N control steps, and its feedback."""

    states: Floats  # x_k, relative to the reference, shape (N + 1, 18)
    actions: Floats  # a_k, shape (N, 4)
    gains: Floats  # K_k, shape (N, 4, 18)


@lru_cache(maxsize=8)
def tracked_plan(gains: SwingUpGains, simulation: Simulation) -> TrackedPlan:
    """Return the plan for a vehicle with its feedback."""
    states, actions = _plan(simulation)
    A, B = _linearise(states, actions, simulation)
    Q, R = _expand(lqr.weights(gains.regulator, simulation)[0]), gains.regulator.effort**-2.0 * np.eye(ACTION_SIZE)
    P = _expand(lqr.riccati(gains.regulator, simulation)[1])
    return TrackedPlan(states, actions, lqr.varying_gains(A, B, Q, R, P))


def _plan(simulation: Simulation) -> tuple[Floats, Floats]:
    """Return x_k and a_k of the plan for a vehicle."""
    for path, planned in PLANS.items():
        vehicle = replace(planned.vehicle, name=simulation.vehicle.name)
        if simulation == replace(planned, vehicle=vehicle, substeps=simulation.substeps, latency=simulation.latency):
            numbers = np.loadtxt(path, delimiter=",", skiprows=1)
            return numbers[:, :STATE_SIZE], numbers[:-1, STATE_SIZE:]
    raise ValueError(
        "swing-up has plans for the vehicle paper, and for hummingbird with the interface body_rates, at 100 Hz,"
        f" not for {simulation.vehicle.name} with {simulation.interface} at {1.0 / simulation.period:g} Hz"
    )


def _expand(matrix: Floats) -> Floats:
    """Return a matrix of the linear model's states, shape (16, 16), for all states; r_z and ṙ_z have no weight."""
    out = np.zeros((STATE_SIZE, STATE_SIZE))
    out[np.ix_(STATE_COLUMNS, STATE_COLUMNS)] = matrix
    return out


def _linearise(states: Floats, actions: Floats, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return the derivatives of the next state along a flight, shapes (N, 18, 18) and (N, 18, 4).

    Rotors follow at once.
    """
    vehicle = simulation.vehicle
    if vehicle.rotors is not None:
        vehicle = replace(vehicle, rotors=replace(vehicle.rotors, lag_up=0.0, lag_down=0.0))
    plant = plant_of(replace(simulation, vehicle=vehicle))

    def moved(points: Floats) -> Floats:
        x, action = (np.ascontiguousarray(part) for part in np.split(points, [STATE_SIZE], axis=1))
        parameters = np.tile(simulation.parameters.as_array(), (len(x), 1))
        plant.advance(x, plant.initial_memory(x), action, np.zeros((len(x), DISTURBANCE_SIZE)), parameters)
        return x

    slopes = jacobian(moved, np.hstack([states[:-1], actions]))
    return slopes[..., :STATE_SIZE], slopes[..., STATE_SIZE:]
