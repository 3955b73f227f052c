"""Nonlinear model-predictive control (NMPC): multiple shooting and real-time iterations with the plant that flies.

At every control step the law improves a plan of states z and actions a over H periods, each of several control steps:

    (1)  minimise    ½ Σ_j ((z_j − z_d)ᵀ Q (z_j − z_d) + (a_j − a_d)ᵀ R (a_j − a_d)) + ½ (z_H − z_d)ᵀ P (z_H − z_d)
    (2)  subject to  z_0 = ẑ,   z_{j+1} = f(z_j, a_j, d̂),   −1 ≤ a_j ≤ 1

f is the simulation of the vehicle with its interface, rate loop and rotor lag, under the estimated disturbance d̂, which
is taken as constant. z is the state of `linear_model`, followed by the thrusts of the rotors of a rigid vehicle. ẑ is
the predicted state at the time when the action begins to act, see `estimation.prediction`. z_d and a_d follow the
trajectory of `modelling.equivalent` under that disturbance. Q has the tolerances of `lqr`, in the axes of the heading,
and P is the solution of the Riccati equation at hover. So the law is an LQR near the reference, and far from it the law
takes the limits and the nonlinear motion into account.

One Gauss–Newton step linearises f along the plan, δz_{j+1} ≈ A δz_j + B δa_j + f(z_j, a_j) − z_{j+1}, and eliminates
the states (condensing). This leaves a quadratic program in the 4 H actions with bounds only, which DAQP solves, a dual
active-set method that CasADi contains (Arnström, Bemporad & Axehill, IEEE Transactions on Automatic Control 2022). The
step starts from the plan of the previous control step, moved forward in time (real-time iteration; Diehl, Bock &
Schlöder, SIAM Journal on Control and Optimization 2005), and first from z_d and a_d. If it fails, the law continues the
previous plan, and after a period the reference. The memory counts the failures.

CasADi is an extra: ``pip install 'quadpend-gym[mpc]'``.
"""

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from quadpend_baselines.controllers.lqr import weights
from quadpend_baselines.estimation.prediction import Estimate, Measurement
from quadpend_baselines.gains import NmpcGains
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import (
    EULER_RATE,
    MODEL_STATE_SIZE,
    POSITION,
    STATE_COLUMNS,
    VELOCITY,
    rotate_state,
)
from quadpend_baselines.modelling.planar import limit_norm
from quadpend_baselines.modelling.reference_horizon import reference_horizon
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE, State
from quadpend_gym.vehicles import mixing

_NO_PLAN = 10**9  # age of the plan at the start of an episode
_MAX_STATE = 1e3  # SI units; a step to a larger state is a failure
_MAX_HORIZONTAL = 0.95  # bound of |r_xy| in a plan
_CONVERGED = 1e-3  # of an action; after a smaller change, no further step is taken
_STEP = 1e-6  # of the finite differences


class NmpcMemory(NamedTuple):
    """Memory of NMPC for n rows."""

    states: Floats  # z, position and velocity relative to the reference, shape (n, H + 1, s)
    actions: Floats  # a, shape (n, H, 4)
    age: Integers  # control steps since the last one whose Gauss–Newton steps succeeded, shape (n,)
    failures: Integers  # control steps that failed since the episode began, shape (n,)


class Horizon(NamedTuple):
    """z_d, shape (n, H + 1, s), a_d, shape (n, H, 4), and the motion of the reference in each period, (n, H, 6)."""

    states: Floats
    actions: Floats
    motion: Floats


@dataclass(frozen=True)
class Nmpc:
    """The control law (1)–(2)."""

    gains: NmpcGains
    simulation: Simulation

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
        return MODEL_STATE_SIZE + (4 if plant_of(self.simulation).memory_size else 0)

    @cached_property
    def _solver(self) -> Any:
        """The quadratic program."""
        import casadi as ca

        size = ACTION_SIZE * self.gains.periods
        problem = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity(0, size)}
        return ca.conic("solver", "daqp", problem, {"error_on_fail": False})

    @cached_property
    def weights(self) -> tuple[Floats, Floats, Floats]:
        """Q and P, shape (s, s), and R, shape (4, 4), of equation (1)."""
        state, command = weights(self.gains.feedback, self.simulation)
        Q = block_diag(state, np.zeros((self.size - MODEL_STATE_SIZE,) * 2))
        units = np.eye(ACTION_SIZE)
        gradient = plant_of(self.simulation).command(_STEP * units) - plant_of(self.simulation).command(0.0 * units)
        gradient = gradient.T / _STEP
        R = gradient.T @ command @ gradient
        if self.simulation.interface == "body_rates":
            rates = self.simulation.command_scale[1:] / self.gains.feedback.angle_rate
            R = np.diag([R[0, 0], *rates**2])
        hover = self._hover()
        _, A, B = self.linearise(hover, np.zeros((1, ACTION_SIZE)), np.zeros((1, 9)))
        P = solve_discrete_are(A[0], B[0], Q, R)
        return Q, P, R

    def _hover(self) -> Floats:
        state = np.zeros((1, STATE_SIZE))
        State(state).direction[:, 2] = 1.0
        return self._coordinates(state, plant_of(self.simulation).initial_memory(state))

    def _coordinates(self, state: Floats, memory: Floats) -> Floats:
        """Return z of states and memories of the plant, shape (n, s)."""
        return np.concatenate([state[:, STATE_COLUMNS], memory[:, ROTOR_THRUST:]], axis=1)

    def _moved(self, z: Floats, action: Floats, disturbance: Floats) -> Floats:
        """Return f(z, a, d̂) of n rows."""
        plant, state = plant_of(self.simulation), np.zeros((len(z), STATE_SIZE))
        state[:, STATE_COLUMNS] = z[:, :MODEL_STATE_SIZE]
        s = State(state)
        s.direction[:, :2] = limit_norm(s.direction[:, :2], _MAX_HORIZONTAL)
        s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
        along = np.sum(s.direction[:, :2] * s.direction_rate[:, :2], axis=1)
        s.direction_rate[:, 2] = -along / s.direction[:, 2]
        memory = plant.initial_memory(state)
        memory[:, ROTOR_THRUST:] = z[:, MODEL_STATE_SIZE:]
        parameters = np.tile(self.simulation.parameters.as_array(), (len(z), 1))
        for _ in range(self.steps):
            plant.advance(state, memory, action, disturbance, parameters)
        return self._coordinates(state, memory)

    def linearise(self, z: Floats, action: Floats, disturbance: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f, shape (n, s), and its derivatives A, shape (n, s, s), and B, shape (n, s, 4)."""
        size, rows = self.size, len(z)
        # f moves with the position, so its derivative with respect to the position is known.
        steps = _STEP * np.eye(size + ACTION_SIZE)[POSITION.stop :]
        steps = np.concatenate([np.zeros((1, size + ACTION_SIZE)), steps])
        points = (np.concatenate([z, action], axis=1)[:, np.newaxis] + steps).reshape(-1, size + ACTION_SIZE)
        moved = self._moved(points[:, :size], points[:, size:].copy(), np.repeat(disturbance, len(steps), axis=0))
        moved = moved.reshape(rows, len(steps), size)
        slopes = np.swapaxes(moved[:, 1:] - moved[:, :1], 1, 2) / _STEP
        A = np.zeros((rows, size, size))
        A[:, POSITION, POSITION] = np.eye(POSITION.stop)
        A[:, :, POSITION.stop :] = slopes[:, :, :-ACTION_SIZE]
        return moved[:, 0], A, slopes[:, :, -ACTION_SIZE:]

    def initial_memory(self, rows: int) -> NmpcMemory:
        """Return the memory without a plan."""
        periods = self.gains.periods
        states, actions = np.zeros((rows, periods + 1, self.size)), np.zeros((rows, periods, ACTION_SIZE))
        return NmpcMemory(states, actions, np.full(rows, _NO_PLAN), np.zeros(rows, np.int64))

    def command(self, estimate: Estimate, measurement: Measurement, memory: NmpcMemory) -> tuple[Floats, NmpcMemory]:
        """Return the actions of equations (1)–(2), shape (n, 4), and the memory."""
        horizon = self._horizon(estimate, measurement)
        age, failures = memory.age + 1, memory.failures.copy()
        old = (age > self.steps)[:, np.newaxis, np.newaxis]
        states = np.where(old, horizon.states, self._later(memory.states))
        actions = np.where(old, horizon.actions, self._later(memory.actions))
        for _ in range(self.gains.iterations):
            new_states, new_actions = self._improved(states, actions, estimate, horizon)
            with np.errstate(invalid="ignore"):
                good = np.isfinite(new_actions).all(axis=(1, 2)) & (np.abs(new_states) < _MAX_STATE).all(axis=(1, 2))
            small = np.abs(new_actions - actions).max() < _CONVERGED
            states = np.where(good[:, np.newaxis, np.newaxis], new_states, states)
            actions = np.where(good[:, np.newaxis, np.newaxis], new_actions, actions)
            if small:
                break
        age, failures = np.where(good, 0, age), failures + ~good
        return actions[:, 0].copy(), NmpcMemory(states, actions, age, failures)

    def _horizon(self, estimate: Estimate, measurement: Measurement) -> Horizon:
        plant, model, rows, periods = (
            plant_of(self.simulation),
            equivalent_model(self.simulation),
            len(estimate.state),
            self.gains.periods,
        )
        period = self.steps * self.simulation.period
        found = reference_horizon(estimate, measurement, self.simulation, period, periods)
        states = np.moveaxis(found.state, 1, 0).reshape(-1, STATE_SIZE)
        commands = np.moveaxis(found.command, 1, 0).reshape(-1, ACTION_SIZE)
        commands = model.body_command(states, commands, np.repeat(estimate.disturbance, periods + 1, axis=0))
        memory = plant.initial_memory(states)
        if memory.shape[1]:
            has_rotors = self.simulation.vehicle.rotors is not None
            memory[:, ROTOR_THRUST:] = (
                np.linalg.solve(mixing(self.simulation.vehicle), commands.T).T if has_rotors else commands
            )
        actions = plant.actions_for(commands, memory if memory.shape[1] else None)[0]
        return Horizon(
            self._coordinates(states, memory).reshape(rows, periods + 1, -1),
            np.asarray(actions, np.float64).reshape(rows, periods + 1, -1)[:, :-1],
            np.moveaxis(found.frame_displacement, 2, 0).reshape(rows, periods, -1),
        )

    def _later(self, plan: Floats) -> Floats:
        """Return the plan one control step later, by linear interpolation between its periods; (n, periods, …)."""
        following = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        return np.asarray(plan + (following - plan) / self.steps)

    def _improved(
        self, states: Floats, actions: Floats, estimate: Estimate, horizon: Horizon
    ) -> tuple[Floats, Floats]:
        """Return the plans after a Gauss–Newton step."""
        rows, periods, size, yaw = len(states), self.gains.periods, self.size, State(estimate.state).euler[:, 2]
        flat = states[:, :-1].reshape(-1, size), actions.reshape(-1, ACTION_SIZE)
        moved, A, B = (
            part.reshape(rows, periods, *part.shape[1:])
            for part in self.linearise(*flat, np.repeat(estimate.disturbance, periods, axis=0))
        )
        moved[:, :, : VELOCITY.stop] -= horizon.motion
        Q, P, R = self.weights
        # Factors of the weights in the axes of the heading.
        turn = np.tile(np.eye(size), (rows, 1, 1))
        for row in range(rows):
            turn[row, :MODEL_STATE_SIZE, :MODEL_STATE_SIZE] = rotate_state(
                np.eye(MODEL_STATE_SIZE), np.full(MODEL_STATE_SIZE, -yaw[row])
            ).T
        stage, last = (_root(weight) @ turn for weight in (Q, P))
        offset = self._coordinates(estimate.state, estimate.rigid) - states[:, 0]
        response = np.zeros((rows, size, ACTION_SIZE * periods))
        offsets, responses, blocks, residuals = [offset], [response], [], []
        for k in range(periods):
            offset = (A[:, k] @ offset[..., np.newaxis])[..., 0] + moved[:, k] - states[:, k + 1]
            response = A[:, k] @ response
            response[:, :, ACTION_SIZE * k : ACTION_SIZE * (k + 1)] = B[:, k]
            factor = stage if k + 1 < periods else last
            deviation = states[:, k + 1] + offset - horizon.states[:, k + 1]
            residuals.append((factor @ deviation[..., np.newaxis])[..., 0])
            blocks.append(factor @ response)
            offsets.append(offset)
            responses.append(response)
        slopes, residual = np.concatenate(blocks, axis=1), np.concatenate(residuals, axis=1)[..., np.newaxis]
        transposed = np.swapaxes(slopes, 1, 2)
        hessian = transposed @ slopes + np.kron(np.eye(periods), R)
        gradient = (transposed @ residual)[..., 0] + ((actions - horizon.actions) @ R).reshape(rows, -1)
        change = np.empty((rows, ACTION_SIZE * periods))
        for row in range(rows):
            given = actions[row].ravel()
            found = self._solver(h=hessian[row], g=gradient[row], lbx=-1.0 - given, ubx=1.0 - given)["x"]
            change[row] = np.asarray(found)[:, 0]
        new = np.stack(
            [o + (r @ change[..., np.newaxis])[..., 0] for o, r in zip(offsets, responses, strict=True)], axis=1
        )
        return states + new, np.clip(actions + change.reshape(actions.shape), -1.0, 1.0)


def _root(weight: Floats) -> Floats:
    """Return L of a weight LᵀL, shape (s, s)."""
    values, vectors = np.linalg.eigh(weight)
    return np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
