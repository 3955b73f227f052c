"""The optimal flight of an episode that is known in advance: direct multiple shooting, solved by IPOPT.

With the states x_k and the actions a_k of all N control steps of an episode as variables:

    (1)  minimise    1/N Σ_{k=1}^{N} |e_k|² + 1/N Σ_{k=0}^{N−1} Σ_i ρ_i a_{k,i}²
    (2)  subject to  x_0 given,   x_{k+1} = f(x_k, a_k, w_k, p),   −1 ≤ a_k ≤ 1
    (3)              r_z ≥ cos α_max,   cos φ cos θ ≥ cos γ_max,   |e_k| ≤ e_max,   z ≥ z_ground

e_k is the tracking error, f one control step of the environment (`Plant`), w_k the wind over it, p the parameters, and
(3) the limits of the task (`Limits`) with small margins. Without its second term, (1) is the squared RMSE of the
episode. The weights ρ raise it by some hundredths of a millimetre only. They are necessary: the RMSE hardly depends on
the yaw and on changes of the torques within a few control periods. The problem is not convex, so the flight is a local
optimum.

The state x of the plant is the state of the environment (`quadpend_gym.physics.state`), followed by the memory of
`engines.step_function`, which contains the actions under way.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines import initial_memory, lift, step_function
from quadpend_gym.engines.functions import actions_under_way
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, POSITION, STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.tasks.task import Limits
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.wind import WIND_SIZE

ACTION_WEIGHTS = (1e-6, 1e-6, 1e-6, 1e-5)  # ρ, m²
COSINE_MARGIN, LENGTH_MARGIN = 1e-4, 1e-3  # of the limits (3): of the cosines, and in m
MAX_ITERATIONS = 200
KNOWN_SIZE = WIND_SIZE + PARAMETERS_SIZE  # wind and parameters of a control period
_SCALE = 1e4  # of the cost: from m² to cm²
_INTERRUPTED = ("NonIpopt_Exception_Thrown", "User_Requested_Stop")  # how CasADi reports Ctrl-C
_OPTIONS: Any = {
    "print_time": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-5, "constr_viol_tol": 1e-6, "max_iter": MAX_ITERATIONS},
}


class KnownEpisode(NamedTuple):
    """An episode of N control steps, without the actions."""

    start: Floats  # first state, shape (18,)
    parameters: Floats  # physical parameters in the order of `Parameters.as_array`, shape (9,)
    wind: Floats  # wind over each control period, laid out as in `quadpend_gym.wind`, shape (N, 12)
    target: Floats  # point to track after each step: x and y of the bob and height of the quadrotor, m, shape (N, 3)


class Flight(NamedTuple):
    """States and actions of a flight of n steps, which ends early if it falls."""

    states: Floats  # shape (n + 1, 18)
    actions: Floats  # actions of the policy, shape (n, 4)


def tracked_point(state: Floats, parameters: Floats) -> Floats:
    """Return x and y of the bob and the height of the quadrotor, m, shape (..., 3), of states, shape (..., 18)."""
    s = State(state)
    bob = s.position + parameters[ROD_LENGTH] * s.direction
    return np.concatenate([bob[..., :2], s.position[..., 2:]], axis=-1)


class Plant(NamedTuple):
    """What determines the motion in a scenario, besides start, parameters and wind."""

    simulation: Simulation  # the vehicle with its latency; hover acts before the first action does
    moves_air: bool = False  # see `engines.step_function`

    @property
    def state_size(self) -> int:
        """Size of x."""
        return STATE_SIZE + int(step_function(self.simulation, self.moves_air).size1_in("memory"))

    def step(self) -> tuple[Any, Any, Any, Any]:
        """Return the symbols x, a and q and the expression of x after a control period.

        a is the action that the policy sends, shape (4, 1), and q wind and parameters, shape (21, 1).
        """
        x, a, q = (ca.SX.sym("x", size) for size in (self.state_size, ACTION_SIZE, KNOWN_SIZE))
        arguments = x[:STATE_SIZE], x[STATE_SIZE:], a, q[:WIND_SIZE], q[WIND_SIZE:]
        return x, a, q, ca.vertcat(*step_function(self.simulation, self.moves_air)(*arguments))

    def memories(self, states: Floats, actions: Floats) -> Floats:
        """Return what follows the states, shape (N + 1, 18), in x, for N actions, shape (N, 4).

        The thrusts of rotors are those at hover.
        """
        late = actions_under_way(self.simulation)
        out, sent = initial_memory(self.simulation, states), np.vstack([np.zeros((late, ACTION_SIZE)), actions])
        for k in range(late):
            first = out.shape[1] - ACTION_SIZE * (late - k)
            out[:, first : first + ACTION_SIZE] = sent[k : k + len(states)]
        return out


class Solution(NamedTuple):
    """The solution of (1)–(3), or the last iterate if IPOPT found none."""

    states: Floats  # states of the plant, shape (N + 1, n)
    actions: Floats  # shape (N, 4), in [−1, 1]
    rmse: float  # root mean square of the tracking error, m
    status: str  # return status of IPOPT, "Solve_Succeeded" at an optimum
    iterations: int  # iterations of IPOPT


class Transcription:
    """The problem (1)–(3) of a plant for episodes of `steps` control steps.

    Args:
        plant: The plant.
        limits: Limits of the task.
        steps: Number N of control steps.
    """

    def __init__(self, plant: Plant, limits: Limits, steps: int) -> None:
        self.plant, self.limits, self.steps = plant, limits, steps
        x, a, known, y = plant.step()
        target, weight, v = ca.SX.sym("target", 3), ca.SX.sym("weight"), ca.vertcat(x, a)
        position, direction, euler = (x[STATE_FIELDS[name]] for name in ("position", "direction", "euler"))
        error = ca.vertcat(position[:2] + known[WIND_SIZE + ROD_LENGTH] * direction[:2], position[2]) - target
        cost = weight * ca.sumsqr(error) + ca.dot(ca.DM(ACTION_WEIGHTS), a**2) / steps
        upright = lift(thrust_axis)(Vec3(*ca.vertsplit(euler))).z
        limited = ca.vertcat(upright, ca.sumsqr(error))
        stage = _Stage(v, ca.vertcat(known, target, weight), y, _SCALE * cost, limited)
        self._solver = _solver(stage, steps)

    def guess(self, flight: Flight, episode: KnownEpisode) -> tuple[Floats, Floats]:
        """Return states of the plant and actions to begin with, from a flight that may end early.

        After the end of the flight they are those of an upright pole at the reference.
        """
        actions = np.zeros((self.steps, ACTION_SIZE))
        actions[: len(flight.actions)] = flight.actions
        states = np.zeros((self.steps + 1, STATE_SIZE))
        states[1:, STATE_FIELDS["position"]] = episode.target
        states[1:, STATE_FIELDS["velocity"]] = np.gradient(episode.target, self.plant.simulation.period, axis=0)
        states[:, DIRECTION + 2] = 1.0
        states[: len(flight.states)] = flight.states
        return np.hstack([states, self.plant.memories(states, actions)]), actions

    def solve(self, episode: KnownEpisode, states: Floats, actions: Floats) -> Solution:
        """Return the optimal flight of an episode of N control steps.

        `states`, shape (N + 1, n), and `actions`, shape (N, 4), are those to begin with.
        """
        first = np.hstack([states, np.vstack([actions, np.zeros(ACTION_SIZE)])])
        lowest, highest = self._bounds(episode.start)
        least = [float(np.cos(self.limits.body_angle)) + COSINE_MARGIN, -np.inf]
        most = [np.inf, (self.limits.tracking_error - LENGTH_MARGIN) ** 2]
        zeros = np.zeros(self.plant.state_size)
        found = self._solver(
            x0=first.ravel(),
            p=self._numbers(episode).ravel(),
            lbx=lowest.ravel(),
            ubx=highest.ravel(),
            lbg=np.concatenate([np.tile([*zeros, *least], self.steps), least]),
            ubg=np.concatenate([np.tile([*zeros, *most], self.steps), most]),
        )
        stats = self._solver.stats()
        if stats["return_status"] in _INTERRUPTED:
            raise KeyboardInterrupt
        plan = np.array(found["x"]).reshape(first.shape)
        x, a = plan[:, : self.plant.state_size], np.clip(plan[:-1, self.plant.state_size :], -1.0, 1.0)
        error = tracked_point(x[1:, :STATE_SIZE], episode.parameters) - episode.target
        rmse = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        return Solution(x, a, rmse, str(stats["return_status"]), int(stats["iter_count"]))

    def _numbers(self, episode: KnownEpisode) -> Floats:
        """Return wind, parameters, target and weight of the error of each stage, shape (N + 1, 25)."""
        out = np.zeros((self.steps + 1, KNOWN_SIZE + 4))
        out[:-1, :WIND_SIZE] = episode.wind
        out[:, WIND_SIZE:KNOWN_SIZE] = episode.parameters
        out[1:, KNOWN_SIZE:-1], out[0, KNOWN_SIZE:-1] = episode.target, episode.target[0]
        out[1:, -1] = 1.0 / self.steps
        return out

    def _bounds(self, start: Floats) -> tuple[Floats, Floats]:
        """Return the bounds of the variables of each stage, shape (N + 1, n + 4)."""
        size, limits = self.plant.state_size, self.limits
        lowest = np.full((self.steps + 1, size + ACTION_SIZE), -np.inf)
        highest = -lowest
        lowest[1:, DIRECTION + 2] = np.cos(limits.pendulum_angle) + COSINE_MARGIN
        lowest[1:, POSITION + 2] = limits.ground + LENGTH_MARGIN
        lowest[:, size:], highest[:, size:] = -1.0, 1.0
        for fixed in (lowest, highest):
            fixed[0, :size] = np.hstack([start, self.plant.memories(start[np.newaxis], np.zeros((0, ACTION_SIZE)))[0]])
            fixed[-1, size:] = 0.0
        return lowest, highest


class _Stage(NamedTuple):
    """Expressions of one stage."""

    v: Any  # its variables, x and a
    q: Any  # numbers that are given
    next: Any  # state of the next stage
    cost: Any  # its share of (1)
    limited: Any  # numbers with limits

    def evaluated(self, output: Any, stages: int) -> Any:
        """Return a function of v and q that evaluates `output` at several stages, side by side."""
        return ca.Function("stage", [self.v, self.q], [output], {"cse": True}).map(stages)


def _solver(stage: _Stage, N: int) -> Any:
    """Return IPOPT for the problem (1)–(3)."""
    size, given = stage.v.numel(), stage.q.numel()
    V, P = ca.MX.sym("V", size * (N + 1)), ca.MX.sym("P", given * (N + 1))
    v, q = ca.reshape(V, size, N + 1), ca.reshape(P, given, N + 1)
    cost, limited = ca.sum2(stage.evaluated(stage.cost, N + 1)(v, q)), stage.evaluated(stage.limited, N + 1)(v, q)
    gaps = v[: stage.next.numel(), 1:] - stage.evaluated(stage.next, N)(v[:, :-1], q[:, :-1])
    g = ca.vertcat(ca.vec(ca.vertcat(gaps, limited[:, :-1])), limited[:, -1])
    problem: Any = {"x": V, "p": P, "f": cost, "g": g}
    return ca.nlpsol("optimal_flight", "ipopt", problem, _OPTIONS)
