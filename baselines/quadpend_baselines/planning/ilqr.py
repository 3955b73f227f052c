"""A better flight of an episode that is known in advance, by iterative LQR in the environment itself.

With the tracking errors e_k, the actions a_k and the weights w_k of the steps (1 where the error is scored, else 0),

    (1)  minimise    J = 1/N Σ_{k=1}^{N} w_k |e_k|² + 1/N Σ_{k=0}^{N−1} Σ_i ρ_i a_{k,i}²,     −1 ≤ a_k ≤ 1
    (2)  δa_k = α d_k + K_k (x_k − x̄_k)

Around a flight x̄, ā the model of the vehicle is linear (`engines.step_function`) and (1) is quadratic in δa. A backward
pass finds d and K, with the bounds of the actions and with the further cost μ/N |δa|². Then ten rows of the environment
fly (2) with α = 1, 1/2, 1/4, …, in the wind of the episode, and the best one that does not fall is the next flight. So
every flight is one of the environment, for every vehicle, interface and loop. It is a local optimum at best.

The model has the nominal loop and no actuators; the flights have those of the scenario. `transcription` has constraints
and exact second derivatives, but saturating rotors keep it from converging.

Source: Tassa, Mansard and Todorov, Control-limited differential dynamic programming, ICRA 2014.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines.planning.episode import record_flight
from quadpend_baselines.planning.transcription import ACTION_WEIGHTS
from quadpend_baselines.policy.protocol import Policy
from quadpend_gym import engines
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines.functions import actions_under_way
from quadpend_gym.envs.outcome import TERMINATED, TRACKING_ERROR
from quadpend_gym.envs.world import world_of
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, POSITION
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles.parameters import ROD_LENGTH

_SHARES = 2.0 ** -np.arange(10)  # α of the rows
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e3  # μ, m²
_SMALL = 1e-6  # relative improvement that ends the search


class Flights(NamedTuple):
    """Flights of m rows and N steps."""

    states: Floats  # x: state, what the vehicle has besides it, and actions under way, shape (N + 1, m, n)
    actions: Floats  # shape (N, m, 4)
    errors: Floats  # tracking errors after each step, m, shape (N, m, 3)
    cost: Floats  # J of equation (1), m²; infinite after a fall; shape (m,)

    def row(self, row: int) -> "Flights":
        """Return one row, without its axis."""
        return Flights(self.states[:, row], self.actions[:, row], self.errors[:, row], self.cost[row])


class Episode:
    """The episode of a seed in a scenario, flown by rows that differ in their actions only."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario, self.seed, self.steps = scenario, seed, scenario.steps
        self.env: Any = scenario.make_vec(len(_SHARES), AutoresetMode.DISABLED, max_episode_steps=self.steps + 1)
        self.world = world_of(self.env)
        self.weights = np.where(np.arange(1, self.steps + 1) * scenario.period > scenario.unscored, 1.0, 0.0)
        self.wind = np.zeros((self.steps, self.world.wind.shape[1]))
        moves_air = any(model.moves_air for model in scenario.wind_models)
        step = engines.step_function(scenario.simulation, moves_air)
        x, memory, a, wind, parameters = step.sx_in()
        variables, results = ca.vertcat(x, memory, a), ca.vertcat(*step.call([x, memory, a, wind, parameters]))
        jacobian = ca.jacobian(results, variables)
        self._slopes = ca.Function("slopes", [variables, wind, parameters], [jacobian], {"cse": True}).map(self.steps)

    def fly(self, actions: Floats, around: Flights | None = None, d: Any = 0.0, K: Any = None) -> Flights:
        """Fly ā, shape (N, 4), or equation (2) around a flight with d, shape (N, 4), and K, shape (N, 4, n)."""
        rows, world = len(_SHARES), self.world
        self.env.reset(seed=[self.seed] * rows)
        under_way = np.zeros((rows, ACTION_SIZE * actions_under_way(self.scenario.simulation)))
        x, flown, errors = [np.hstack([world.state, world.plant_memory, under_way])], [], []
        fell = np.zeros(rows, np.bool_)
        for k in range(self.steps):
            a = np.tile(actions[k], (rows, 1))
            if around is not None:
                a = a + np.outer(_SHARES, d[k]) + (x[k] - around.states[k]) @ K[k].T
            a = np.where(fell[:, np.newaxis], 0.0, np.clip(a, -1.0, 1.0)).astype(np.float32)
            self.wind[k] = world.wind[0]
            _, outcome = world.step(a)
            fell |= outcome[TERMINATED] > 0.0
            under_way = np.hstack([under_way, a])[:, ACTION_SIZE:]
            x.append(np.hstack([world.state, world.plant_memory, under_way]))
            flown.append(a.astype(np.float64))
            errors.append(outcome[TRACKING_ERROR].T.copy())
        used, error = np.array(flown), np.array(errors)
        squares = np.einsum("k,kmi->m", self.weights, error**2) + np.einsum("i,kmi->m", ACTION_WEIGHTS, used**2)
        return Flights(np.array(x), used, error, np.where(fell, np.inf, squares / self.steps))

    def linearise(self, flight: Flights) -> tuple[Floats, Floats]:
        """Return A and B along a flight, shapes (N, n, n) and (N, n, 4)."""
        parameters = np.tile(self.world.parameters[0], (self.steps, 1))
        stacked = self._slopes(np.hstack([flight.states[:-1], flight.actions]).T, self.wind.T, parameters.T)
        size = flight.states.shape[1]
        slopes = np.array(stacked).reshape(size, self.steps, size + ACTION_SIZE).transpose(1, 0, 2)
        return slopes[..., :size], slopes[..., size:]

    def backward(self, flight: Flights, damping: float) -> tuple[Floats, Floats]:
        """Return d and K of equation (2)."""
        (A, B), size = self.linearise(flight), flight.states.shape[1]
        C, R = np.zeros((3, size)), np.diag(ACTION_WEIGHTS)
        C[:, POSITION : POSITION + 3] = np.eye(3)
        C[:2, DIRECTION : DIRECTION + 2] = self.world.parameters[0, ROD_LENGTH] * np.eye(2)
        d, K = np.zeros((self.steps, ACTION_SIZE)), np.zeros((self.steps, ACTION_SIZE, size))
        P, p = np.zeros((size, size)), np.zeros(size)  # of the remaining cost, ½ δxᵀ P δx + pᵀ δx, times N/2
        for k in reversed(range(self.steps)):
            S, s = P + self.weights[k] * C.T @ C, p + self.weights[k] * C.T @ flight.errors[k]
            Q_ux, q_u = B[k].T @ S @ A[k], B[k].T @ s + R @ flight.actions[k]
            Q_uu = B[k].T @ S @ B[k] + R
            damped = Q_uu + damping * np.eye(ACTION_SIZE)
            d[k], free = _bounded_minimum(damped, q_u, -1.0 - flight.actions[k], 1.0 - flight.actions[k])
            K[k, free] = -np.linalg.solve(damped[np.ix_(free, free)], Q_ux[free])
            P = A[k].T @ S @ A[k] + K[k].T @ Q_uu @ K[k] + K[k].T @ Q_ux + Q_ux.T @ K[k]
            P, p = 0.5 * (P + P.T), A[k].T @ s + K[k].T @ (Q_uu @ d[k] + q_u) + Q_ux.T @ d[k]
        return d, K


def _bounded_minimum(H: Floats, q: Floats, low: Floats, high: Floats) -> tuple[Floats, Any]:
    """Return the minimum of ½ vᵀ H v + qᵀ v with low ≤ v ≤ high, by projected Newton steps, and which are free."""
    v, free = np.zeros(len(q)), np.ones(len(q), np.bool_)
    for _ in range(8):
        slope = q + H @ v
        free = ~((v <= low) & (slope > 0.0) | (v >= high) & (slope < 0.0))
        step = np.zeros(len(q))
        step[free] = -np.linalg.solve(H[np.ix_(free, free)], slope[free])
        v, last = np.clip(v + step, low, high), v
        if np.abs(v - last).max() < 1e-12:
            break
    return v, free


def improve_flight(policy: Policy, scenario: Scenario, seed: int, iterations: int = 30) -> Flights:
    """Return the best flight of an episode that is found from that of a policy, which must not fall.

    The policy is adapted to the scenario.
    """
    episode = Episode(scenario, seed)
    env = scenario.make_vec(1, AutoresetMode.SAME_STEP, max_episode_steps=scenario.steps + 1)
    first = record_flight(policy.adapt(scenario), env, seed, scenario.steps)
    if len(first.actions) < scenario.steps:
        raise ValueError(f"the policy falls in the episode of seed {seed}: give one that survives it")
    best, damping = episode.fly(first.actions).row(0), _FIRST_DAMPING
    for _ in range(iterations):
        flights = episode.fly(best.actions, best, *episode.backward(best, damping))
        row = int(np.argmin(flights.cost))
        before, best = best.cost, flights.row(row) if flights.cost[row] < best.cost else best
        if best.cost == before:
            damping *= 10.0
        elif row < 2:
            damping *= (0.25, 0.5)[row]
        elif row > 2:
            damping *= 3.0
        if damping > _LARGEST_DAMPING or 0.0 < before - best.cost < _SMALL * before:
            break
    return best
