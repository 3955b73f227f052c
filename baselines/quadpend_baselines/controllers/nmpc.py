"""Nonlinear model-predictive control (NMPC): multiple shooting and real-time iterations with the plant that flies.

At every control step the law improves a plan of states z and actions a over H periods, each of several control steps:

    (1)  minimise    ½ Σ_j ((z_j − z_d)ᵀ Q (z_j − z_d) + (a_j − a_d)ᵀ R (a_j − a_d)) + ½ (z_H − z_d)ᵀ P (z_H − z_d)
    (2)  subject to  z_0 = ẑ,   z_{j+1} = f(z_j, a_j, d̂),   −1 ≤ a_j ≤ 1

f is the simulation of the vehicle with its interface, rate loop and rotor lag, under the estimated disturbance d̂, which
is taken as constant. z is the state of `linear_model`, followed by the thrusts of the rotors of a rigid vehicle. ẑ is
the predicted state when the action begins to act, after the latency (`estimation.prediction`). z_d and a_d follow the
trajectory of `modelling.equivalent` under d̂. Q has the tolerances of `lqr`, in the axes of the heading, R those of
thrust and torques, or of body rates, and P solves the Riccati equation at hover. So the law is an LQR near the
reference, and far from it the law takes the limits and the nonlinear motion into account.

A Gauss–Newton step linearises f along the plan and eliminates the states (condensing):

    (3)  δz_0 = ẑ − z_0,      δz_{j+1} = A_j δz_j + B_j δa_j + f(z_j, a_j) − z_{j+1}
    (4)  δz_j = o_j + Γ_j δa

This leaves a quadratic program in the 4 H actions with bounds only. DAQP solves it, a dual active-set method that
CasADi contains (Arnström, Bemporad & Axehill, IEEE Transactions on Automatic Control 2022). One step starts from the
plan of the previous control step, moved forward in time (real-time iteration; Diehl, Bock & Schlöder, SIAM Journal on
Control and Optimization 2005), at first from z_d and a_d. If it fails, the law continues the previous plan, and after a
period z_d and a_d. The memory counts the failures.

CasADi is an extra: ``pip install 'quadpend-gym[mpc]'``.
"""

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from math import factorial
from threading import Lock
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from quadpend_baselines.controllers.law import Law
from quadpend_baselines.controllers.lqr import LqrGains, weights
from quadpend_baselines.estimation.estimate import ORDERS, Estimate
from quadpend_baselines.gains import Count, EstimatorGains, Scale
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import (
    MODEL_STATE_SIZE,
    POSITION,
    STATE_COLUMNS,
    VELOCITY,
    jacobian,
    limit_norm,
    rotate_state,
)
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.vehicles import mixing

_NO_PLAN = 10**9  # age of the plan at the start of an episode
_MAX_STATE = 1e3  # SI units; a step to a larger state is a failure
_MAX_HORIZONTAL = 0.95  # bound of |r_xy| in a plan
_SOLVING = Lock()  # threads may share a controller, but CasADi's solvers and the graphs that they share have no locks


@settings
class NmpcGains:
    """Gains of `controllers.nmpc`."""

    feedback: LqrGains = LqrGains()  # weights of the cost
    periods: Count = 13  # H, periods of the horizon
    period: Annotated[float, Range(1e-4, 10.0, "s"), Scale(-1)] = 0.04  # T, period of the horizon
    estimator: EstimatorGains = EstimatorGains()


class NmpcMemory(NamedTuple):
    """Memory of NMPC for n rows."""

    states: Floats  # z, position and velocity relative to the reference, shape (n, H + 1, s)
    actions: Floats  # a, shape (n, H, 4)
    age: Integers  # control steps since the last one whose Gauss–Newton step succeeded, shape (n,)
    failures: Integers  # control steps that failed since the episode began, shape (n,)


class Horizon(NamedTuple):
    """The reference of n rows over the horizon."""

    states: Floats  # z_d, shape (n, H + 1, s)
    actions: Floats  # a_d, shape (n, H, 4)
    motion: Floats  # of position (m) and velocity (m/s) of the reference in each period, shape (n, H, 6)


@dataclass(frozen=True)
class Nmpc(Law):
    """The control law (1)–(2)."""

    gains: NmpcGains
    has_linear_model = False
    has_c = False
    commands_actions = True

    def __post_init__(self) -> None:
        if find_spec("casadi") is None:
            raise ValueError("nmpc needs CasADi, which is not installed: pip install 'quadpend-gym[mpc]'")

    @cached_property
    def steps(self) -> int:
        """Control steps in a period of the horizon."""
        return max(round(self.gains.period / self.simulation.period), 1)

    @cached_property
    def size(self) -> int:
        """Length s of z."""
        return int(MODEL_STATE_SIZE) + (ACTION_SIZE if plant_of(self.simulation).memory_size else 0)

    @cached_property
    def weights(self) -> tuple[Floats, Floats, Floats]:
        """Q, shape (s, s), R, shape (4, 4), and P, shape (s, s), of equation (1)."""
        plant, (state, command) = plant_of(self.simulation), weights(self.gains.feedback, self.simulation)
        Q = block_diag(state, np.zeros((self.size - MODEL_STATE_SIZE,) * 2))
        hover, zero = np.zeros((1, STATE_SIZE)), np.zeros((1, ACTION_SIZE))
        State(hover).direction[:, 2] = 1.0
        slope = jacobian(plant.command, zero)[0]
        R = slope.T @ command @ slope
        if self.simulation.interface == "body_rates":
            rates = self.simulation.command_scale[1:] / self.gains.feedback.angle_rate
            R = np.diag([R[0, 0], *rates**2])
        z = self._coordinates(hover, plant.initial_memory(hover))
        _, A, B = self.linearise(z, zero, np.zeros((1, DISTURBANCE_SIZE)))
        return Q, R, solve_discrete_are(A[0], B[0], Q, R)

    @cached_property
    def _roots(self) -> Floats:
        """Factors L of the weights LᵀL of z_1 … z_H, shape (H, s, s)."""
        Q, _, P = self.weights
        values, vectors = np.linalg.eigh(np.stack([Q] * (self.gains.periods - 1) + [P]))
        return np.asarray(np.sqrt(np.maximum(values, 0.0))[..., np.newaxis] * np.swapaxes(vectors, 1, 2))

    @cached_property
    def _solver(self) -> Any:
        """The quadratic program."""
        import casadi as ca

        size = ACTION_SIZE * self.gains.periods
        problem = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity(0, size)}
        return ca.conic("solver", "daqp", problem, {"error_on_fail": False})

    def initial_memory(self, rows: int) -> NmpcMemory:
        """Return the memory without a plan."""
        periods = self.gains.periods
        states, actions = np.zeros((rows, periods + 1, self.size)), np.zeros((rows, periods, ACTION_SIZE))
        return NmpcMemory(states, actions, np.full(rows, _NO_PLAN), np.zeros(rows, np.int64))

    def command(self, estimate: Estimate, memory: NmpcMemory) -> tuple[Floats, NmpcMemory]:
        """Return the actions of equations (1)–(2), shape (n, 4), and the memory."""
        horizon, age = self._horizon(estimate), memory.age + 1
        is_old = (age > self.steps)[:, np.newaxis, np.newaxis]
        plan = np.where(is_old, horizon.states, self._later(memory.states))
        actions = np.where(is_old, horizon.actions, self._later(memory.actions))
        found = self._improved(plan, actions, estimate, horizon)
        with np.errstate(invalid="ignore"):
            succeeds = sum(np.abs(array).max(axis=(1, 2)) for array in found) < _MAX_STATE
        plan[succeeds], actions[succeeds] = found[0][succeeds], found[1][succeeds]
        memory = NmpcMemory(plan, actions, np.where(succeeds, 0, age), memory.failures + ~succeeds)
        return actions[:, 0].copy(), memory

    def linearise(self, z: Floats, action: Floats, disturbance: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f of n rows, shape (n, s), and its derivatives A, shape (n, s, s), and B, shape (n, s, 4).

        Differences of the simulation take less time than its derivatives as generated C.
        """
        size, moving = self.size, POSITION.stop  # f moves along with the position
        points = np.hstack([z, action])

        def moved(free: Floats) -> Floats:
            flown = np.repeat(points, len(free) // len(points), axis=0)
            flown[:, moving:] = free
            under = np.repeat(disturbance, len(free) // len(points), axis=0)
            return self._moved(flown[:, :size], flown[:, size:].copy(), under)

        slopes = jacobian(moved, points[:, moving:])
        A = np.concatenate([np.tile(np.eye(size, moving), (len(z), 1, 1)), slopes[..., :-ACTION_SIZE]], axis=2)
        return self._moved(z, action, disturbance), A, slopes[..., -ACTION_SIZE:]

    def _moved(self, z: Floats, action: Floats, disturbance: Floats) -> Floats:
        """Return f(z, a, d̂) of n rows."""
        plant, state = plant_of(self.simulation), np.zeros((len(z), STATE_SIZE))
        state[:, STATE_COLUMNS] = z[:, :MODEL_STATE_SIZE]
        s = State(state)
        s.direction[:, :2] = limit_norm(s.direction[:, :2], _MAX_HORIZONTAL)
        s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
        s.direction_rate[:, 2] = -np.sum(s.direction * s.direction_rate, axis=1) / s.direction[:, 2]
        memory = plant.initial_memory(state)
        memory[:, ROTOR_THRUST:] = z[:, MODEL_STATE_SIZE:]
        parameters = np.tile(self.simulation.parameters.as_array(), (len(z), 1))
        for _ in range(self.steps):
            plant.advance(state, memory, action, disturbance, parameters)
        return self._coordinates(state, memory)

    def _coordinates(self, state: Floats, memory: Floats) -> Floats:
        """Return z, shape (n, s), of states and memories of the plant."""
        return np.hstack([state[:, STATE_COLUMNS], memory[:, ROTOR_THRUST:]])[:, : self.size]

    def _horizon(self, estimate: Estimate) -> Horizon:
        """Return the reference, extrapolated by its Taylor polynomial of order 6, under the estimated disturbance."""
        simulation, (rows, steps) = self.simulation, (len(estimate.state), self.gains.periods + 1)
        period, derivatives = self.steps * simulation.period, estimate.reference[:, np.newaxis]
        t = period * np.arange(steps)
        future = np.zeros((rows, steps, ORDERS, 3))
        for order in range(ORDERS):
            for power in range(ORDERS - order):
                future[:, :, order] += (t**power / factorial(power))[:, np.newaxis] * derivatives[:, :, order + power]
        yaw, rate, acceleration = (column[:, np.newaxis] for column in estimate.yaw.T)
        turned = yaw + t * rate + t**2 / 2 * acceleration, rate + t * acceleration, acceleration
        yaws = np.stack(np.broadcast_arrays(*turned), axis=-1).reshape(-1, 3)
        disturbance, plant = np.repeat(estimate.disturbance, steps, axis=0), plant_of(simulation)
        model = equivalent_model(simulation)
        state, command = model.trajectory(future.reshape(-1, ORDERS, 3), yaws, disturbance)
        command = model.body_command(state, command, disturbance)
        motion = [
            sum(period ** (i + order) / factorial(i + order) * future[:, :-1, i] for i in range(ORDERS))
            for order in (2, 1)  # of position, of velocity
        ]
        memory = plant.initial_memory(state)
        has_rotors = simulation.vehicle.rotors is not None
        thrusts = np.linalg.solve(mixing(simulation.vehicle), command.T).T if has_rotors else command
        memory[:, ROTOR_THRUST:] = thrusts[:, : self.size - MODEL_STATE_SIZE]
        action = plant.actions_for(command, memory)
        return Horizon(
            self._coordinates(state, memory).reshape(rows, steps, -1),
            action.astype(np.float64).reshape(rows, steps, -1)[:, :-1],
            np.concatenate(motion, axis=-1),
        )

    def _later(self, plan: Floats) -> Floats:
        """Return the plan one control step later, by linear interpolation between its periods; (n, periods, …)."""
        following = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        return np.asarray(plan + (following - plan) / self.steps)

    def _improved(self, plan: Floats, actions: Floats, estimate: Estimate, horizon: Horizon) -> tuple[Floats, Floats]:
        """Return the states and actions of the plans after a Gauss–Newton step (3)–(4); nan where it fails."""
        (rows, periods, _), size, width = actions.shape, self.size, MODEL_STATE_SIZE
        disturbance = np.repeat(estimate.disturbance, periods, axis=0)
        found = self.linearise(np.concatenate(plan[:, :-1]), np.concatenate(actions), disturbance)
        moved, A, B = (part.reshape(rows, periods, *part.shape[1:]) for part in found)
        moved[..., : VELOCITY.stop] -= horizon.motion
        heading = np.tile(np.eye(size), (rows, 1, 1))  # from the world frame to the axes of the heading
        yaw = np.repeat(-State(estimate.state).euler[:, 2], width)
        heading[:, :width, :width] = rotate_state(np.tile(np.eye(width), (rows, 1)), yaw).reshape(rows, width, width)
        heading = np.swapaxes(heading, 1, 2)

        offsets = np.empty_like(plan)
        responses, slopes = (np.zeros((rows, periods + 1, size, ACTION_SIZE * periods)) for _ in range(2))
        residuals = np.zeros_like(plan)
        offsets[:, 0] = self._coordinates(estimate.state, estimate.rigid) - plan[:, 0]
        for k, root in enumerate(self._roots):
            offsets[:, k + 1] = (A[:, k] @ offsets[:, k, :, np.newaxis])[..., 0] + moved[:, k] - plan[:, k + 1]
            responses[:, k + 1] = A[:, k] @ responses[:, k]
            responses[:, k + 1, :, ACTION_SIZE * k : ACTION_SIZE * (k + 1)] = B[:, k]
            deviation = plan[:, k + 1] + offsets[:, k + 1] - horizon.states[:, k + 1]
            factor = root @ heading
            residuals[:, k + 1] = (factor @ deviation[..., np.newaxis])[..., 0]
            slopes[:, k + 1] = factor @ responses[:, k + 1]
        _, R, _ = self.weights
        slope = slopes.reshape(rows, -1, ACTION_SIZE * periods)
        transposed = np.swapaxes(slope, 1, 2)
        hessian = transposed @ slope + np.kron(np.eye(periods), R)
        gradient = transposed @ residuals.reshape(rows, -1, 1)
        gradient = gradient[..., 0] + ((actions - horizon.actions) @ R).reshape(rows, -1)
        given = actions.reshape(rows, -1)
        change = np.empty_like(given)
        with _SOLVING:
            for row in range(rows):
                bounds = {"lbx": -1.0 - given[row], "ubx": 1.0 - given[row]}
                change[row] = np.asarray(self._solver(h=hessian[row], g=gradient[row], **bounds)["x"])[:, 0]
        states = plan + offsets + (responses @ change[:, np.newaxis, :, np.newaxis])[..., 0]
        return states, np.clip(given + change, -1.0, 1.0).reshape(actions.shape)
