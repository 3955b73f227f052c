"""Control steps and their cost as generated C, with the products that gradients of a window need.

A flight is z, the state x of a row, followed by what its vehicle and its actuators remember (`engines.step_function`;
the actions under way, the oldest first, and the lagged actions), and by the last states if the sensors are delayed, the
oldest first. A step of a row is

    (1)  z ← f(z, clip(a, −1, 1)),   e² = |e|²,   c = w₁ |e| + w_ψ ψ_e² + w_a |a|² + w_ω |η̇|² + w_l ℓ + excess

with the terms that `apg` explains, in the state that the action a leads to. CasADi reads the equations of the
environments (`quadpend_gym.engines`) and differentiates them; `observed` adds what the policy observes then. What is
drawn for an episode or a step (gyro bias, lost packets, the loop) is an argument. Actuators round no action to float32,
as the environment's do.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
import torch
from torch import Tensor

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_gym import engines
from quadpend_gym.actuators import ActionDelay, GyroBias, MotorLag, PacketLoss, lag_shares
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import kind_of
from quadpend_gym.engines import CompiledFunction, columns, lift
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.plant_kernel import LOOP_SIZE
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, EULER_RATE, STATE_SIZE
from quadpend_gym.physics.vectors import load
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.references import POINT_SIZE
from quadpend_gym.tasks.task import Limits
from quadpend_gym.tasks.trajectories import Reference
from quadpend_gym.vehicles import Simulation
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE
from quadpend_gym.wind import WIND_SIZE
from quadpend_gym.wind.base import can_hold
from quadpend_train.envs.concatenated import worlds
from quadpend_train.training.observed import Observer, observation_step
from quadpend_train.training.settings import ApgSettings

Item = TypeVar("Item")
_ENOUGH = 0.6  # margin to a limit above which leaning costs nothing
_DRAWN = {PacketLoss: 1, GyroBias: 3}  # numbers that an actuator draws


class Kind(NamedTuple):
    """What the flights of a scenario depend on."""

    simulation: Simulation
    actuators: tuple[Any, ...]
    moves_air: bool
    sensor_delay: int
    loop: LoopRanges | None
    observer: Observer

    @classmethod
    def of(cls, scenario: Scenario, hybrid: Any, size: int) -> "Kind":
        """Return the kind of a scenario's flights, for a policy with `size` observations and its hybrid, or None."""
        rigid = scenario.simulation.vehicle.attitude == "rigid"  # it has drag in still air, too
        moves_air = rigid or any(model.moves_air for model in scenario.wind_models)
        observer = Observer.of(hybrid, scenario.observation, size)
        delay = Loop.of(scenario.sensors).sensor_delay
        return cls(scenario.simulation, scenario.actuators, moves_air, delay, scenario.loop, observer)

    @property
    def actuators_size(self) -> int:
        """Numbers that the actuators remember."""
        return sum(int(model.memory_size) for model in self.actuators if not isinstance(model, GyroBias))

    @property
    def drawn_size(self) -> int:
        """Numbers of a step that the environment draws."""
        loop = 0 if self.loop is None else LOOP_SIZE + self.simulation.substeps
        return sum(_DRAWN.get(type(model), 0) for model in self.actuators) + loop

    def drawn(self, world: Any, before: Sequence[Floats]) -> Floats:
        """Return what was drawn for the step that a world has done, shape (n, k).

        `before` are the memories of its actuators before the step.
        """
        parts: list[Floats] = []
        for model, last, memory in zip(self.actuators, before, world.actuator_memories, strict=True):
            if isinstance(model, PacketLoss):
                parts.append((memory == last).all(axis=1, keepdims=True).astype(np.float64))
            elif isinstance(model, GyroBias):
                parts.append(memory)
        if self.loop is not None:
            parts.append(world.schedule.loops.T)
        return np.hstack([np.zeros((world.num_envs, 0)), *parts])

    def initial(self, state: Floats) -> Floats:
        """Return flights at the beginning of episodes with states of shape (n, 18), shape (n, k)."""
        remembered = np.zeros((len(state), self.actuators_size))
        return np.hstack(
            [state, engines.initial_memory(self.simulation, state, self.loop), remembered, *[state] * self.sensor_delay]
        )


def check_covered(name: str, scenario: Scenario) -> None:
    """Check that APG can fly a scenario."""
    for model in scenario.actuators:
        if not isinstance(model, ActionDelay | MotorLag | PacketLoss | GyroBias):
            raise ValueError(
                f"algo 'apg' cannot have the actuator {kind_of(model)!r}, only 'action_delay', 'motor_lag',"
                f" 'packet_loss' and 'gyro_bias' (scenario {name})"
            )
    if can_hold(scenario.wind_models):
        raise ValueError(f"algo 'apg' cannot have the wind 'hold' (scenario {name})")
    if scenario.loop is not None and scenario.simulation.vehicle.attitude != "rigid":
        raise ValueError(f"algo 'apg' draws the loop of rigid vehicles only, not that of the scenario {name}")
    trajectory = scenario.task.trajectory
    if scenario.task.jumps is not None and trajectory is not None and not isinstance(trajectory, Reference):
        raise ValueError(f"algo 'apg' cannot have task.jumps with waypoints (scenario {name})")
    if scenario.task.pendulum != "upright" or scenario.task.reward.pendulum_first > 0.0:
        raise ValueError(f"algo 'apg' balances an upright pendulum only, not the task of the scenario {name}")


@lru_cache(maxsize=32)
def control_step(kind: Kind) -> Any:
    """Return a control step with its actuators, (flight, action, wind, parameters, drawn) → (next_flight)."""
    step = engines.step_function(kind.simulation, kind.moves_air, kind.loop)
    vehicle_size = STATE_SIZE + step.size1_in("memory")
    names = "flight", "action", "wind", "parameters", "drawn"
    sizes = vehicle_size + kind.actuators_size, ACTION_SIZE, WIND_SIZE, PARAMETERS_SIZE, kind.drawn_size
    arguments = [ca.SX.sym(*pair) for pair in zip(names, sizes, strict=True)]
    flight, action, wind, parameters, drawn = arguments
    remembered, first = [], vehicle_size
    for model in kind.actuators:
        own, drawn = drawn[: _DRAWN.get(type(model), 0)], drawn[_DRAWN.get(type(model), 0) :]
        if isinstance(model, GyroBias):
            rates = action[1:] - own / kind.simulation.command_scale[1:]
            action = ca.vertcat(action[0], ca.fmin(ca.fmax(rates, -1.0), 1.0))
            continue
        memory, first = flight[first : first + model.memory_size], first + model.memory_size
        if isinstance(model, ActionDelay):
            under_way = ca.vertcat(memory, action)
            action, memory = under_way[:ACTION_SIZE], under_way[ACTION_SIZE:]
        elif isinstance(model, PacketLoss):
            action = memory = action + own * (memory - action)
        else:
            (mean, left), gap = lag_shares(kind.simulation.period / model.time_constant), memory - action
            action, memory = action + mean * gap, action + left * gap
        remembered.append(memory)
    loop = [] if kind.loop is None else [drawn]
    after = step(flight[:STATE_SIZE], flight[STATE_SIZE:vehicle_size], action, wind, parameters, *loop)
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
    """Return equation (1) and its product, together with that of equation (1) of `observed`.

    They are (flight, action, wind, parameters, drawn, point, weights) → (next_flight, costs), where costs are e² and c,
    and

    (the same, belief, sensing, error of the sensors, adjoints of next_flight, costs, next_belief and observation) →
    (adjoint of the flight, of the belief, of the action).
    """
    step, observe = control_step(kind), observation_step(kind.observer)
    size = step.size1_in("flight")
    flight = ca.SX.sym("flight", size + STATE_SIZE * kind.sensor_delay)
    arguments = [flight, *step.sx_in()[1:], ca.SX.sym("point", POINT_SIZE), ca.SX.sym("weights", 8)]
    _, action, wind, parameters, drawn, point, weights = arguments
    bounded = ca.fmin(ca.fmax(action, -1.0), 1.0)
    after = step(flight[:size], bounded, wind, parameters, drawn)
    state, states = after[:STATE_SIZE], ca.vertcat(flight[size:], after[:STATE_SIZE])
    _, error = engines.observation_function()(state, parameters, point)
    costs = _costs(state, action, error, state[EULER + 2] - point[POINT_SIZE - 3], weights)
    results = [ca.vertcat(after, states[STATE_SIZE:]), costs]
    names = [*step.name_in(), "point", "weights"]
    values = ca.Function("flight", arguments, results, names, ["next_flight", "costs"])

    belief, sensing, noise = observe.sx_in("belief"), observe.sx_in("sensing"), ca.SX.sym("noise", STATE_SIZE)
    results += observe(states[:STATE_SIZE] + noise, parameters, point, bounded, belief, sensing)
    names, outputs = [*names, "belief", "sensing", "noise"], ["next_flight", "costs", "next_belief", "observation"]
    everything = ca.Function("seen", [*arguments, belief, sensing, noise], results, names, outputs)
    adjoints = [f"adj:{name}" for name in outputs]
    product = everything.factory("product", [*names, *adjoints], ["adj:flight", "adj:belief", "adj:action"])
    return CompiledFunction(values), CompiledFunction(product)


def reference_points(scenarios: Sequence[Scenario], reference: Floats, time: Floats) -> Floats:
    """Return the references of the rows at a time (s), shape (n, 24), from those in `World.reference`."""
    (points,) = _compiled_reference()(reference, time[:, np.newaxis])
    parts = zip(scenarios, *(np.split(array, len(scenarios)) for array in (points, time)), strict=True)
    for scenario, point, t in parts:
        trajectory = scenario.task.trajectory
        if trajectory is not None and not isinstance(trajectory, Reference):
            derivatives = trajectory.derivatives(t)
            point[:, :-3], point[:, -3:] = derivatives[:, :, :3].reshape(len(t), -1), derivatives[:, :3, 3]
    return points


@lru_cache(maxsize=1)
def _compiled_reference() -> CompiledFunction:
    return CompiledFunction(engines.reference_function())


class Flights:
    """The flights of n rows, an equal number of each of several scenarios, in their order.

    Arrays of rows whose flights and beliefs have different sizes are filled up with zeros. `wrappers` are those of the
    hybrids of all rows, and `size` is that of the policy's observation.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        wrappers: Sequence[VectorHybridWrapper],
        rows: int,
        size: int,
        apg: ApgSettings,
    ) -> None:
        # Neighbouring scenarios of one kind share their calls
        share, self._limit = rows // len(scenarios), apg.max_state_gradient / (apg.window * rows)
        hybrids: list[Any] = [item.hybrid for item in wrappers for _ in worlds(item)] or [None] * len(scenarios)
        self.hybrid = hybrids[0]
        self._kinds = kinds = [Kind.of(*pair, size) for pair in zip(scenarios, hybrids, strict=True)]
        self._parts = [
            (rows, kind, *compiled_steps(kind))
            for rows, kind in _slices((kind, share * len(list(group))) for kind, group in groupby(kinds))
        ]
        self._wrappers = list(_slices((item, item.num_envs) for item in wrappers))
        self._observers = {id(hybrid): kind.observer for hybrid, kind in zip(hybrids, kinds, strict=True)}
        # Numbers of the cost of each row, an argument of `step`, shape (n, 8)
        self.weights = np.repeat([_weights(apg, scenario.task.limits) for scenario in scenarios], share, axis=0)

    def initial(self, state: Floats) -> Floats:
        """Return the flights at the beginning of episodes with states of shape (n, 18), shape (n, k)."""
        return _stacked([kind.initial(state[rows]) for rows, kind, *_ in self._parts])

    def beliefs(self) -> tuple[Floats, Floats]:
        """Return what the observers believe now, and what they need in the next step, see `Observer.values`."""
        found = [self._observers[id(item.hybrid)].values(item.memory) for _, item in self._wrappers]
        if not found:
            return np.zeros((len(self.weights), 0)), np.zeros((len(self.weights), 0))
        return _stacked([belief for belief, _ in found]), _stacked([sensing for _, sensing in found])

    def drawn(self, everything: Sequence[Any], before: Sequence[Sequence[Floats]]) -> Floats:
        """Return what was drawn for the last step of all worlds, see `Kind.drawn`."""
        parts = zip(self._kinds, everything, before, strict=True)
        return _stacked([kind.drawn(*rest) for kind, *rest in parts])

    def delayed(self, flight: Floats, after: Floats) -> Floats:
        """Return the states that the sensors measure after a step, before and after which the flights are given."""
        out = after[:, :STATE_SIZE].copy()
        for rows, kind, *_ in self._parts:
            if kind.sensor_delay:
                first = kind.initial(out[:1]).shape[1] - STATE_SIZE * kind.sensor_delay
                out[rows] = flight[rows, first : first + STATE_SIZE]
        return out

    def step(self, flight: Floats, *others: Floats) -> tuple[Floats, Floats]:
        """Return the next flights, shape (n, k), and the costs, shape (n, 2).

        The other arguments are actions, wind, parameters, drawn numbers, points and weights, see `compiled_steps`.
        """
        results = [_call(values, rows, flight, *others) for rows, _, values, _ in self._parts]
        return _stacked([after for after, _ in results]), np.vstack([costs for _, costs in results])

    def product(self, arguments: Sequence[Floats], adjoints: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
        """Return the adjoints of flights, beliefs and actions, see `compiled_steps`.

        The adjoints of each row, without that of the costs, are first scaled so that the norm of that of the state is
        limited; it grows without bound while a row falls.
        """
        flight, costs, *seen = adjoints
        norm = np.linalg.norm(flight[:, :STATE_SIZE], axis=1, keepdims=True)
        share = np.minimum(self._limit / (norm + 1e-12), 1.0)
        limited = share * flight, costs, *(share * item for item in seen)
        results = [_call(product, rows, *arguments, *limited) for rows, *_, product in self._parts]
        flights, beliefs, actions = zip(*results, strict=True)
        return _stacked(flights), _stacked(beliefs), np.vstack(actions)


def _slices(items: Iterable[tuple[Item, int]]) -> Iterator[tuple[slice, Item]]:
    """Return items with the rows that they have, one after the other, from pairs of an item and its number of rows."""
    first = 0
    for item, count in items:
        yield slice(first, first := first + count), item


def _call(function: CompiledFunction, rows: slice, *arrays: Floats) -> tuple[Floats, ...]:
    """Call a function for some rows, with as many columns as it takes."""
    sizes = (function.function.size1_in(i) for i in range(len(arrays)))
    return function(*(array[rows, :size] for array, size in zip(arrays, sizes, strict=True)))


def _stacked(arrays: Sequence[Floats]) -> Floats:
    """Return arrays one below the other, with as many columns as the widest."""
    width = max(array.shape[1] for array in arrays)
    if all(array.shape[1] == width for array in arrays):
        return np.vstack(arrays)
    return np.vstack([np.pad(array, ((0, 0), (0, width - array.shape[1]))) for array in arrays])


class Step(torch.autograd.Function):
    """A control step with gradients: the values of the environment, and their slopes by `Flights.product`."""

    @staticmethod
    def forward(
        ctx: Any, flight: Tensor, belief: Tensor, action: Tensor, given: Sequence[Any], values: Sequence[Any]
    ) -> tuple[Tensor, ...]:
        """Return `values`: flights, costs, beliefs and observations after the step.

        `given` are `Flights`, the other arguments of its product, and the rows, shape (n,), that began a new episode
        after the step, which does not depend on what was before.
        """
        ctx.given = flight.numpy(), belief.numpy(), action.numpy(), *given
        return tuple(torch.as_tensor(value) for value in values)

    @staticmethod
    def backward(ctx: Any, *adjoints: Tensor) -> Any:
        """Return the gradients of flight, belief and action."""
        flight, belief, action, flights, constants, sensing, noise, ended = ctx.given
        flows = np.where(ended, 0.0, 1.0)[:, np.newaxis]
        after, costs, believed, seen = (item.numpy() for item in adjoints)
        arguments = flight, action, *constants, belief, sensing, noise
        before = flights.product(arguments, (flows * after, costs, flows * believed, flows * seen))
        return *map(torch.as_tensor, before[:2]), torch.as_tensor(before[2], dtype=torch.float32), None, None
