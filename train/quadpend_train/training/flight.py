"""Control steps and their cost as generated C, with the products that gradients of a window need.

A flight is z, the state x of a row, followed by what its vehicle and its actuators remember (`engines.step_function`;
the actions under way, the oldest first, and the lagged actions). A step of a row is

    (1)  z ← f(z, clip(a, −1, 1)),   e² = |e|²,   c = w₁ |e| + w_ψ ψ_e² + w_a |a|² + w_ω |η̇|² + w_l ℓ + excess

with the terms that `apg` explains, in the state that the action a leads to. CasADi reads the equations of the
environments (`quadpend_gym.engines`) and differentiates them. Actuators round no action to float32, as the
environment's do.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import torch
from torch import Tensor

from quadpend_gym import engines
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.engines import CompiledFunction, columns, lift
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, EULER_RATE, STATE_SIZE
from quadpend_gym.physics.vectors import load
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.task import Limits
from quadpend_gym.tasks.trajectories import Reference
from quadpend_gym.vehicles import Simulation
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE
from quadpend_gym.wind import WIND_SIZE
from quadpend_train.training.settings import ApgSettings

POINT_SIZE = 24  # of a reference point, see `engines.functions`
_ENOUGH = 0.6  # margin to a limit above which leaning costs nothing


class Kind(NamedTuple):
    """What the flights of a scenario depend on."""

    simulation: Simulation
    actuators: tuple[Any, ...]
    moves_air: bool

    @classmethod
    def of(cls, scenario: Scenario) -> "Kind":
        """Return the kind of a scenario's flights."""
        moves_air = any(model.moves_air for model in scenario.wind_models)
        return cls(scenario.simulation, scenario.actuators, moves_air)

    @property
    def actuators_size(self) -> int:
        """Numbers that the actuators remember."""
        return sum(int(model.memory_size) for model in self.actuators)

    def initial(self, state: Floats) -> Floats:
        """Return flights at the beginning of episodes with states of shape (n, 18), shape (n, k)."""
        remembered = np.zeros((len(state), self.actuators_size))
        return np.hstack([state, engines.initial_memory(self.simulation, state), remembered])


def check_covered(name: str, scenario: Scenario) -> None:
    """Check that APG can fly a scenario."""
    for model in scenario.actuators:
        if not isinstance(model, ActionDelay | MotorLag):
            raise ValueError(
                f"algo 'apg' cannot have the actuator {model.kind!r}, only 'action_delay' and 'motor_lag' (scenario"
                f" {name})"
            )
    if scenario.task.pendulum != "upright" or scenario.task.reward.pendulum_first > 0.0:
        raise ValueError(f"algo 'apg' balances an upright pendulum only, not the task of the scenario {name}")


@lru_cache(maxsize=32)
def control_step(kind: Kind) -> Any:
    """Return a control step with its actuators, (flight, action, wind, parameters) → (next_flight)."""
    step = engines.step_function(kind.simulation, kind.moves_air)
    vehicle_size = STATE_SIZE + step.size1_in("memory")
    names, sizes = ("flight", "action", "wind", "parameters"), (vehicle_size + kind.actuators_size, ACTION_SIZE)
    arguments = [ca.SX.sym(*pair) for pair in zip(names, (*sizes, WIND_SIZE, PARAMETERS_SIZE), strict=True)]
    flight, action, wind, parameters = arguments
    remembered, first = [], vehicle_size
    for model in kind.actuators:
        memory, first = flight[first : first + model.memory_size], first + model.memory_size
        if isinstance(model, ActionDelay):
            under_way = ca.vertcat(memory, action)
            action, memory = under_way[:ACTION_SIZE], under_way[ACTION_SIZE:]
        else:
            ratio, gap = kind.simulation.period / model.time_constant, memory - action
            action, memory = action - math.expm1(-ratio) / ratio * gap, action + math.exp(-ratio) * gap
        remembered.append(memory)
    after = step(flight[:STATE_SIZE], flight[STATE_SIZE:vehicle_size], action, wind, parameters)
    return ca.Function("control_step", arguments, [ca.vertcat(*after, *remembered)], names, ["next_flight"])


def _weights(apg: ApgSettings, limits: Limits) -> Floats:
    """Return w₁, w_ψ, w_a, w_ω, w_l, the cosines of the limits of both tilts, and the limit of |e| (m)."""
    tilts = math.cos(limits.pendulum_angle), math.cos(limits.body_angle)
    return np.array([apg.error, apg.yaw, apg.effort, apg.rate, apg.lean, *tilts, limits.tracking_error])


def _costs(state: Any, action: Any, error: Any, yaw_error: Any, weights: Any) -> Any:
    """Return e² and c of equation (1)."""
    w_error, w_yaw, w_effort, w_rate, w_lean, upright, level, largest = ca.vertsplit(weights)
    squared, rate = ca.sumsqr(error), state[EULER_RATE : EULER_RATE + 3]
    axis = lift(thrust_axis)(lift(load)(columns(state), EULER, 0))
    margins = (
        (state[DIRECTION + 2] - upright) / (1.0 - upright),
        (axis.z - level) / (1.0 - level),
        1.0 - ca.sqrt(squared + 1e-12) / largest,
    )
    lean = sum(ca.fmax(_ENOUGH - margin, 0.0) ** 2 for margin in margins)
    cost = w_error * ca.sqrt(squared + 1e-8) + w_yaw * yaw_error**2 + w_effort * ca.sumsqr(action)
    excess = ca.sumsqr(ca.fmax(ca.fabs(action) - 1.0, 0.0))
    return ca.vertcat(squared, cost + w_rate * ca.sumsqr(rate) + w_lean * lean + excess)


@lru_cache(maxsize=32)
def compiled_steps(kind: Kind) -> tuple[CompiledFunction, CompiledFunction]:
    """Return equation (1) and its product.

    They are (flight, action, wind, parameters, point, weights) → (next_flight, costs), where costs are e² and c, and

    (the same arguments, adjoints of the two results) → (adjoint of the flight, adjoint of the action).
    """
    step = control_step(kind)
    arguments = [*step.sx_in(), ca.SX.sym("point", POINT_SIZE), ca.SX.sym("weights", 8)]
    flight, action, wind, parameters, point, weights = arguments
    after = step(flight, ca.fmin(ca.fmax(action, -1.0), 1.0), wind, parameters)
    state = after[:STATE_SIZE]
    _, error = engines.observation_function()(state, parameters, point)
    costs = _costs(state, action, error, state[EULER + 2] - point[POINT_SIZE - 3], weights)
    names = [*step.name_in(), "point", "weights"]
    function = ca.Function("flight", arguments, [after, costs], names, ["next_flight", "costs"])
    product = function.factory("product", [*names, "adj:next_flight", "adj:costs"], ["adj:flight", "adj:action"])
    return CompiledFunction(function), CompiledFunction(product)


def reference_points(scenarios: Sequence[Scenario], reference: Floats, time: Floats) -> Floats:
    """Return the references of the rows at a time (s), shape (n, 24).

    Args:
        scenarios: The scenarios, which have the same number of rows.
        reference: References as in `World.reference`, shape (n, 20).
        time: Times, shape (n,).
    """
    (points,) = _compiled_reference()(reference, time[:, np.newaxis])
    parts = zip(scenarios, *(np.split(array, len(scenarios)) for array in (points, time)), strict=True)
    for scenario, point, t in parts:
        trajectory = scenario.task.trajectory
        if not isinstance(trajectory, Reference | None):
            derivatives = trajectory.derivatives(t)
            point[:, :-3], point[:, -3:] = derivatives[:, :, :3].reshape(len(t), -1), derivatives[:, :3, 3]
    return points


@lru_cache(maxsize=1)
def _compiled_reference() -> CompiledFunction:
    return CompiledFunction(engines.reference_function())


class Flights:
    """The flights of n rows, an equal number of each of several scenarios, in their order.

    Args:
        scenarios: The scenarios, which `check_covered` accepts.
        rows: Number n of rows, a multiple of the number of scenarios.
        apg: Weights of the cost.

    Attributes:
        size: Numbers k of a flight; those of some scenarios may have fewer, which come first.
        weights: Numbers of the cost of each row, an argument of `step`, shape (n, 8).
    """

    def __init__(self, scenarios: Sequence[Scenario], rows: int, apg: ApgSettings) -> None:
        """Find the kinds of flights; neighbouring scenarios of one kind share their calls."""
        share, first, self._limit = rows // len(scenarios), 0, apg.max_state_gradient / (apg.window * rows)
        self._parts: list[tuple[slice, Kind, int, CompiledFunction, CompiledFunction]] = []
        for kind, group in groupby(map(Kind.of, scenarios)):
            part = slice(first, first := first + share * len(list(group)))
            self._parts.append((part, kind, control_step(kind).size1_in(0), *compiled_steps(kind)))
        self.size = max(size for _, _, size, *_ in self._parts)
        self.weights = np.repeat([_weights(apg, scenario.task.limits) for scenario in scenarios], share, axis=0)

    def initial(self, state: Floats) -> Floats:
        """Return the flights at the beginning of episodes with states of shape (n, 18), shape (n, k)."""
        out = np.zeros((len(state), self.size))
        for rows, kind, size, *_ in self._parts:
            out[rows, :size] = kind.initial(state[rows])
        return out

    def step(self, flight: Floats, *others: Floats) -> tuple[Floats, Floats]:
        """Return the next flights, shape (n, k), and the costs, shape (n, 2).

        Args:
            flight: Flights, shape (n, k).
            others: Actions, wind, parameters, points and weights, shapes (n, 4), (n, 12), (n, 9), (n, 24) and (n, 8).
        """
        after, costs = np.zeros_like(flight), np.empty((len(flight), 2))
        for rows, _, size, step, _ in self._parts:
            after[rows, :size], costs[rows] = step(flight[rows, :size], *(array[rows] for array in others))
        return after, costs

    def product(
        self, flight: Floats, others: Sequence[Floats], adjoint: Floats, costs_adjoint: Floats
    ) -> tuple[Floats, Floats]:
        """Return the adjoints of flights and actions from those of the results of `step`.

        The norm of each row of `adjoint` is limited first; it grows without bound while a row falls.
        """
        norm = np.linalg.norm(adjoint, axis=1, keepdims=True)
        adjoint = adjoint * np.minimum(self._limit / (norm + 1e-12), 1.0)
        before, action = np.zeros_like(flight), np.empty((len(flight), ACTION_SIZE))
        for rows, _, size, _, product in self._parts:
            arrays = *(array[rows] for array in others), adjoint[rows, :size], costs_adjoint[rows]
            before[rows, :size], action[rows] = product(flight[rows, :size], *arrays)
        return before, action


class Step(torch.autograd.Function):
    """A control step with gradients: the flights of the environment, and their slopes by `Flights.product`."""

    @staticmethod
    def forward(
        ctx: Any,
        flight: Tensor,
        action: Tensor,
        flights: Flights,
        others: Sequence[Floats],
        after: Floats,
        costs: Floats,
        ended: Booleans,
    ) -> tuple[Tensor, Tensor]:
        """Return what `Flights.step` has computed.

        Args:
            ctx: The context of PyTorch.
            flight: Flights before the step, shape (n, k).
            action: Actions, shape (n, 4).
            flights: Computes the products.
            others: Actions, wind, parameters, points and weights.
            after: Flights after the step, and after the reset of the rows that ended.
            costs: Costs.
            ended: Rows whose flight after the step does not depend on that before, shape (n,).
        """
        ctx.arguments = flights, flight.numpy(), others, ended
        return torch.as_tensor(after), torch.as_tensor(costs)

    @staticmethod
    def backward(ctx: Any, adjoint: Tensor, costs_adjoint: Tensor) -> Any:
        """Return the gradients of flight and action."""
        flights, flight, others, ended = ctx.arguments
        through = np.where(ended[:, np.newaxis], 0.0, adjoint.numpy())
        before, action = flights.product(flight, others, through, costs_adjoint.numpy())
        return torch.as_tensor(before), torch.as_tensor(action, dtype=torch.float32), *(None,) * 5
