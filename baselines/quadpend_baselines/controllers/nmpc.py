"""Nonlinear model-predictive control (NMPC): multiple shooting and real-time iterations, in CasADi.

At every control step the law improves a plan of states X and commands U over H periods of length T:

    (1)  minimise    ½ Σ_j ((x_j − x_d)ᵀ Q (x_j − x_d) + (u_j − u_d)ᵀ R (u_j − u_d)) + barrier
                         + ½ (x_H − x_d)ᵀ P (x_H − x_d)
    (2)  subject to  x_0 = x̂,   x_{j+1} = f(x_j, u_j, d̂),   u_min ≤ u_j ≤ u_max

f is the motion over a period under the estimated disturbance d̂, which is taken as constant (`nmpc_model`). x_d and u_d
are the trajectory of `flat_outputs` under that disturbance. Q, R and P are those of `lqr` with the period T, in the
axes of the heading. So the law is an LQR near the reference, and far from it the law takes the limits and the nonlinear
motion into account. The barrier penalises states close to an early termination: soft bounds on the tilt of pendulum and
body.

The law takes at most `iterations` Gauss–Newton steps (`nmpc_solver`), which start from the plan of the previous control
step, moved forward in time (real-time iteration; Diehl, Bock & Schlöder, SIAM Journal on Control and Optimization
2005). The first plan of an episode is the motion under the feedback of the LQR. If a step fails, the law continues the
previous plan, and after the time T the feedback of the LQR. The memory counts the failures.

The model of a rigid vehicle is the rigid body with its pole (`nmpc_model`). x_d and u_d are those of the equivalent
pendulum (`modelling.equivalent`). The lag of the rotors is left out.

CasADi is an extra: ``pip install 'quadpend-gym[mpc]'``.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib.util import find_spec
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.estimation.prediction import Estimate, Measurement
from quadpend_baselines.gains import NmpcGains
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_baselines.modelling.reference_horizon import Horizon, reference_horizon
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE, State

_LONGEST_SUBSTEP = 0.4  # of the model, as a share of the time in which an upright pole's tilt grows by the factor e
_NO_PLAN = 10**9  # age of the plan at the start of an episode
_MAX_STATE = 1e3  # SI units; a step to a larger state is a failure
_CONVERGED = 1e-3  # share of the range of the action: after a smaller change, no further step is taken


class NmpcMemory(NamedTuple):
    """Memory of NMPC for n rows."""

    states: Floats  # X, position and velocity relative to the reference, shape (n, H + 1, 18)
    commands: Floats  # U, N and N·m, shape (n, H, 4)
    age: Integers  # control steps since the last one whose Gauss–Newton steps succeeded, shape (n,)
    failures: Integers  # control steps that failed since the episode began, shape (n,)


@lru_cache(maxsize=32)
def model(simulation: Simulation) -> Any:
    """Return `nmpc_model.period_map`."""
    from quadpend_baselines.controllers import nmpc_model

    return nmpc_model.period_map(simulation)


@lru_cache(maxsize=32)
def sqp_step(gains: NmpcGains, simulation: Simulation) -> Any:
    """Return `nmpc_solver.sqp_step` with the weights of `lqr`."""
    from quadpend_baselines.controllers import nmpc_solver

    (Q, R), (_, P) = weights(gains.feedback, simulation), riccati(gains.feedback, simulation)
    return nmpc_solver.sqp_step(simulation, Q, R, P, gains.periods)


@dataclass(frozen=True)
class Nmpc:
    """The control law (1)–(2)."""

    gains: NmpcGains
    simulation: Simulation

    def __post_init__(self) -> None:
        if find_spec("casadi") is None:
            raise ValueError("nmpc needs CasADi, which is not installed: pip install 'quadpend-gym[mpc]'")

    @cached_property
    def horizon_simulation(self) -> Simulation:
        """The simulation with the period of the horizon, commanded by thrust and torques without latency."""
        period = self.gains.period
        rate = np.sqrt(equivalent_model(self.simulation).parameters.chain_stiffness)
        substeps = ceil(period * rate / _LONGEST_SUBSTEP)
        return replace(self.simulation, period=period, substeps=substeps, interface="wrench", latency=0.0)

    @cached_property
    def limits(self) -> Floats:
        """Lowest and highest command, N and N·m, shape (4, 2)."""
        out = self.horizon_simulation.command_scale[:, np.newaxis] * [[0.0, 2.0], *[[-1.0, 1.0]] * 3]
        rotors = self.simulation.vehicle.rotors
        if rotors is not None:
            out[0] = np.clip(out[0], 4.0 * rotors.thrust[0], 4.0 * rotors.thrust[1])
        return np.asarray(out)

    def initial_memory(self, rows: int) -> NmpcMemory:
        """Return the memory without a plan."""
        periods = self.gains.periods
        states, commands = np.zeros((rows, periods + 1, STATE_SIZE)), np.zeros((rows, periods, COMMAND_SIZE))
        return NmpcMemory(states, commands, np.full(rows, _NO_PLAN), np.zeros(rows, np.int64))

    def command(self, estimate: Estimate, measurement: Measurement, memory: NmpcMemory) -> tuple[Floats, NmpcMemory]:
        """Return the command of equations (1)–(2) and the memory; see `output_feedback.ControlLaw`."""
        gains, horizon = self.gains, self._horizon(estimate, measurement)
        states, commands = self._later(memory.states), self._later(memory.commands)
        age, failures = memory.age + 1, memory.failures.copy()
        old = age * self.simulation.period > gains.period
        if old.any():
            first = self._linear_feedback_plan(estimate, horizon)
            states, commands = (
                np.where(old[:, np.newaxis, np.newaxis], new, kept)
                for new, kept in zip(first, (states, commands), strict=True)
            )
        for row in range(len(states)):
            plan = self._improved(states[row], commands[row], estimate, horizon, row)
            if plan is None:
                failures[row] += 1
            else:
                (states[row], commands[row]), age[row] = plan, 0
        return commands[:, 0].copy(), NmpcMemory(states, commands, age, failures)

    def _horizon(self, estimate: Estimate, measurement: Measurement) -> Horizon:
        """Return the reference over the horizon; its commands have torques about the axes of the body."""
        horizon = reference_horizon(estimate, measurement, self.simulation, self.gains.period, self.gains.periods)
        states, commands = horizon.state.reshape(-1, STATE_SIZE), horizon.command.reshape(-1, COMMAND_SIZE)
        disturbances = np.tile(estimate.disturbance, (self.gains.periods + 1, 1))
        commands = equivalent_model(self.simulation).body_command(states, commands, disturbances)
        return horizon._replace(command=commands.reshape(horizon.command.shape))

    def _later(self, plan: Floats) -> Floats:
        """Return the plan one control step later, by linear interpolation between its periods; (n, periods, …)."""
        following = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        share = min(self.simulation.period / self.gains.period, 1.0)
        return np.asarray(plan + share * (following - plan))

    def _linear_feedback_plan(self, estimate: Estimate, horizon: Horizon) -> tuple[Floats, Floats]:
        """Return X and U of the motion from the estimated states under the feedback of the LQR, within the limits."""
        gain, _ = riccati(self.gains.feedback, self.horizon_simulation)
        step, (lowest, highest) = model(self.horizon_simulation), self.limits.T
        state, states, commands = estimate.state, [estimate.state], []
        for x_d, u_d, motion in zip(horizon.state, horizon.command, horizon.frame_displacement, strict=False):
            x = rotate_state((state - x_d)[:, STATE_COLUMNS], -State(state).euler[:, 2])
            feedback = np.sum(x[:, np.newaxis] * gain, axis=-1)  # unlike BLAS, the same bits for one row and many
            commands.append(np.clip(u_d - feedback, lowest, highest))
            state = np.array(step(state.T, commands[-1].T, estimate.disturbance.T)).T
            State(state).position[:] -= motion[0]
            State(state).velocity[:] -= motion[1]
            states.append(state)
        return np.stack(states, axis=1), np.stack(commands, axis=1)

    def _improved(
        self, states: Floats, commands: Floats, estimate: Estimate, horizon: Horizon, row: int
    ) -> tuple[Floats, Floats] | None:
        """Return the plan of one row, shapes (H + 1, 18) and (H, 4), after Gauss–Newton steps; None if they fail."""
        step = sqp_step(self.gains, self.horizon_simulation)
        constants = (
            estimate.state[row],
            estimate.disturbance[row],
            horizon.state[:, row].T,
            horizon.command[:-1, row].T,
            horizon.frame_displacement[:, :, row].reshape(self.gains.periods, -1).T,
            self.limits,
        )
        small = _CONVERGED * self.horizon_simulation.command_scale
        for _ in range(self.gains.iterations):
            before = commands
            states, commands = (np.asarray(part).T for part in step(states.T, commands.T, *constants))
            if not (np.abs(states).max() < _MAX_STATE and np.isfinite(commands).all()):
                return None
            if (np.abs(commands - before) < small).all():
                break
        return states, np.clip(commands, *self.limits.T)
