"""Hybrids of a classical base controller and a policy.

At every control step a hybrid first computes the policy's observation (`Hybrid.observe`), and then computes the action
that is applied to the environment from the policy's action (`Hybrid.act`). The classes use the policy's action
a ∈ [−1, 1]⁴ in different ways, with the action scale κ:

| class            | applied action                                                                                   |
|------------------|--------------------------------------------------------------------------------------------------|
| `EstimateOnly`   | (1)  a                                                                                           |
| `MemoryOnly`     | (1)  a; the base controller does not fly: it is the teacher                                      |
| `LabOnly`        | (3)  clip(a_n + 2 a, −1, 1) with the linear feedback a_n of a filter, see `lab`; likewise        |
| `HistoryOnly`    | (1)  a; there is no base controller                                                              |
| `ResidualAction` | (2)  clip(a_base + κ a, −1, 1)                                                                   |

The policy's observation contains, in this order,

| part                                                                                    | size     | scale      |
|-----------------------------------------------------------------------------------------|----------|------------|
| the observation of the base controller's state estimate; without one, the environment's | 36 or 27 | its own    |
| the estimated disturbance, with the layout of ``info["disturbance"]``                   | 9        | 1 N, 1 N·m |
| the action of the base controller; with `ResidualAction` only                           | 4        | 1          |
| the situation, see `situation`; with ``EstimateOnly(situation=True)`` only              | 12       | its own    |
| filtered innovations, see `innovations`; with ``EstimateOnly(innovations=True)`` only   | 32       | its own    |

With ``EstimateOnly(deviations=True)`` the inputs of `deviations` take the place of the first two parts. `MemoryOnly`
has the inputs of `memory` alone, `LabOnly` those of `lab`, `HistoryOnly` those of `history`.
``LabOnly(feedback=False)`` has a_d of `lab` in place of a_n in (3).

`ResidualAction` multiplies the part of the observation that depends on the state, and the base controller's action, by
ten, because the base controller keeps these values small.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np

from quadpend_baselines.controllers.law import ObserverKind
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import errors_of
from quadpend_baselines.hybrid.deviations import deviation_part
from quadpend_baselines.hybrid.history import history_part
from quadpend_baselines.hybrid.innovations import innovations_part
from quadpend_baselines.hybrid.lab import FOLLOWING, NEAR, OUTPUT, lab_part
from quadpend_baselines.hybrid.memory import memory_part
from quadpend_baselines.hybrid.parts import (
    MAGNIFICATION,
    InputPart,
    Seen,
    base_action_part,
    disturbance_part,
    estimated_part,
    observed_part,
    read_inputs,
)
from quadpend_baselines.hybrid.situation import situation_part
from quadpend_baselines.policy.protocol import Policy
from quadpend_baselines.registry import controller
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.settings import Range, parse, settings
from quadpend_gym.physics.state import ACTION_SIZE

Reads = Literal["estimates", "measurements", "lab"]


class HybridMemory(NamedTuple):
    """The state of a hybrid between two calls, for n rows."""

    controller: Any  # memory of the base controller
    base_action: Floats32  # the action on which the policy builds, (n, 4), see `Hybrid.builds_on`
    inputs: Floats  # memories of the parts of the inputs, see `parts.read_inputs`
    action: Floats32  # the last applied action, (n, 4); zeros at the start of an episode


class Hybrid:
    """A base controller combined with a policy."""

    kind: ClassVar[str]  # the key of the class in `HYBRIDS`
    # What the policy's observation is made of; measurements are errors, or with "lab" those of `LAB` in the world
    reads: ClassVar[Reads] = "estimates"
    output: ClassVar[float] = 1.0  # factor on the action of a policy that acts alone, see `builds_on`
    flies_load: ClassVar[bool] = False  # whether it also flies a hanging pendulum
    observers: ClassVar[tuple[ObserverKind, ...]] = ("kalman", "deso")  # those of the base controllers that it takes
    base_controller: Any  # one of `quadpend_baselines.CONTROLLERS`, or an object

    def __post_init__(self) -> None:
        if getattr(self._given, "observer", "hidden") not in self.observers:
            raise ValueError(
                f"base_controller must be a controller that estimates the disturbance, not {self.base_controller!r}"
            )

    @cached_property
    def _given(self) -> Any:
        """The base controller as an object."""
        return controller(self.base_controller) if isinstance(self.base_controller, str) else self.base_controller

    @cached_property
    def controller(self) -> Any:
        """The base controller, which estimates the disturbance."""
        return self._given

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid with its base controller designed for another nominal simulation and loop."""
        return replace(self, base_controller=self._given.designed_for(simulation, loop))  # type: ignore[type-var]

    def flown_in(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid as a policy needs it to fly in a nominal simulation with a known loop."""
        return self.designed_for(simulation, loop)

    @abstractmethod
    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation if that of the environment has `size` numbers."""

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation if the environment's observation has `size` numbers."""
        return sum(part.size for part in self.parts(size))

    def observe(self, observation: Floats32, memory: Any, episode_start: Any) -> tuple[Floats32, HybridMemory]:
        """Update the base controller's estimate and make the policy's observation.

        Args:
            observation: Observation of the environment, as the base controller reads it.
            memory: Memory that the last call of `act` returned; None at the first step.
            episode_start: Mask of the rows whose episode begins with this observation, shape (n,).

        Returns:
            The policy's observation, shape (n, m) with m from `observation_size`, and the memory for `act`.
        """
        base, rows = self.controller, len(observation)
        has_errors = self.reads == "lab" or not base.loop.in_world
        errors = observation if has_errors else errors_of(observation, self._vehicle)
        parts = self.parts(errors.shape[1])
        if memory is None:
            updated, action = base.update(observation, None, episode_start), np.zeros((rows, ACTION_SIZE), np.float32)
            own = np.zeros((rows, sum(part.memory_size for part in parts)))
        else:
            updated, started = base.update(observation, memory.controller, episode_start), episode_start[:, np.newaxis]
            own, action = np.where(started, 0.0, memory.inputs), np.where(started, np.float32(0.0), memory.action)
        base_action, updated = self._first_action(updated, rows)
        seen = Seen(errors, action, base_action, *base.estimates(updated))
        found, own = read_inputs(parts, seen, own)
        inputs = found.astype(np.float32)
        return inputs, HybridMemory(updated, self.builds_on(inputs, base_action), own, action)

    def builds_on(self, inputs: Any, base_action: Any) -> Any:
        """Return the action on which the policy builds, from its observation and that of an acting base controller.

        It has zeros where the policy acts alone.
        """
        return base_action

    def _first_action(self, updated: Any, rows: int) -> tuple[Floats32, Any]:
        """Return the action of the base controller if it acts before the policy, else zeros, and its memory."""
        return np.zeros((rows, ACTION_SIZE), np.float32), updated

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the action that the base controller would apply, shape (n, 4), and the memory after that, for `act`.

        Base controllers with an integral or a plan expect this call in every step.

        `memory` is that which the last call of `observe` returned.
        """
        action, updated = self.controller.control(memory.controller)
        return action, memory._replace(controller=updated)

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Turn the policy's action into the action to apply, and pass the latter to the base controller's observer.

        Args:
            action: Action of the policy, shape (n, 4).
            memory: Memory that the last call of `observe` or `base_action` returned.

        Returns:
            The action to apply to the environment, shape (n, 4), and the memory for the next call of `observe`.
        """
        applied = self._applied(action, memory.base_action)
        return applied, memory._replace(
            controller=self.controller.with_applied_action(memory.controller, applied), action=applied
        )

    def _applied(self, action: Floats32, base_action: Floats32) -> Floats32:
        return action

    @property
    def _vehicle(self) -> Parameters:
        parameters: Parameters = self.controller.simulation.parameters
        return parameters


@settings
class EstimateOnly(Hybrid):
    """Hybrid whose policy acts alone, equation (1).

    The policy observes the base controller's estimate of the disturbance, and that of the state at the time when the
    next action acts: with known delays and lags it is predicted through them.
    """

    kind: ClassVar[str] = "estimate_only"
    base_controller: Any = "adrc-matched"  # a name from `quadpend_baselines.CONTROLLERS`, or a controller
    situation: bool = False  # whether the policy observes the situation, which needs a Kalman observer
    deviations: bool = False  # whether it observes deviations from the reference's trajectory, which needs lqg
    innovations: bool = False  # whether it observes filtered innovations, which need a Kalman observer

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.deviations and not (self.controller.observer == "kalman" and self.controller._law.is_linear_near):
            raise ValueError(f"deviations needs the base_controller lqg, not {self.base_controller!r}")
        if (self.situation or self.innovations) and self.controller.observer != "kalman":
            raise ValueError(
                f"situation and innovations need a base_controller with a Kalman observer, not {self.base_controller!r}"
            )

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        base, weight = self.controller, self._vehicle.hover_thrust
        if self.deviations:
            parts = [deviation_part(base._law)]
        elif base.observer == "kalman":
            parts = [estimated_part("later", self._vehicle.rod_length), disturbance_part(weight)]
        else:
            parts = [observed_part(size), disturbance_part(weight)]
        if self.situation:
            parts.append(situation_part(base.simulation.period, weight))
        if self.innovations:
            parts.append(innovations_part(base.simulation.period))
        return tuple(parts)


class NoController(Policy):
    """In place of a base controller: it estimates nothing, and does not act."""

    observer: ObserverKind = "none"

    def __init__(self, simulation: Simulation, loop: Loop | None = None) -> None:
        self.simulation, self.loop = simulation, loop or Loop()

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "NoController":
        """Return the same for another simulation and loop."""
        return NoController(simulation, loop)

    def update(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[()]:
        """Return an empty memory."""
        return ()

    def estimates(self, memory: Any) -> tuple[Any, Any]:
        """Return no estimates."""
        return (), ()

    def control(self, memory: Any) -> Any:
        """Refuse to act."""
        raise ValueError("a hybrid that was made for a flight has no teacher: ask for one with teaches=True")

    def with_applied_action(self, memory: Any, action: Floats32) -> tuple[()]:
        """Return an empty memory."""
        return ()


@settings
class MemoryOnly(Hybrid):
    """Hybrid whose policy acts alone, equation (1), on the measurements and a memory of them, see `memory`.

    It gets no parameters of its vehicle. The base controller is its teacher, which only `designed_for` adds.
    """

    kind: ClassVar[str] = "memory_only"
    reads: ClassVar[Reads] = "measurements"
    observers: ClassVar[tuple[ObserverKind, ...]] = (*Hybrid.observers, "none")
    base_controller: Any = "lqg"  # a name from `quadpend_baselines.CONTROLLERS`, or a controller

    @cached_property
    def controller(self) -> Any:
        """The teacher, or no controller."""
        return NoController(Simulation()) if isinstance(self.base_controller, str) else self.base_controller

    def flown_in(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid without its teacher; see `Hybrid.flown_in`."""
        return replace(self, base_controller=NoController(simulation, loop and loop.of_errors))

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        return (memory_part(self.controller.simulation.period, self.controller.loop.observation),)


@settings
class LabOnly(MemoryOnly):
    """Hybrid whose policy acts on the observation `LAB` and a memory of it, see `lab`, equation (3)."""

    kind: ClassVar[str] = "lab_only"
    reads = "lab"
    output = OUTPUT
    feedback: bool = True  # False: a_d, the command of the trajectory, in place of a_n

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        return (lab_part(self.controller.simulation, self.controller.loop.noise),)

    def builds_on(self, inputs: Any, base_action: Any) -> Any:
        """Return a_n or a_d; see `Hybrid.builds_on`."""
        return inputs[:, NEAR if self.feedback else FOLLOWING]

    def _applied(self, action: Floats32, base_action: Floats32) -> Floats32:
        applied: Floats32 = np.clip(base_action + np.float32(self.output) * action, -1.0, 1.0)
        return applied


@settings
class HistoryOnly(Hybrid):
    """Hybrid whose policy acts alone, equation (1), on the latest observations and actions, see `history`.

    It has no base controller.
    """

    kind: ClassVar[str] = "history"
    reads = "measurements"
    flies_load = True
    observations: Annotated[int, Range(1, 1000)] = 4  # the present one included
    actions: Annotated[int, Range(0, 1000)] = 0
    base_controller: Any = field(default=NoController(Simulation()), init=False)

    def __post_init__(self) -> None:
        if (self.observations, self.actions) == (1, 0):
            raise ValueError("a history must have 2 or more observations, or 1 or more actions")

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid."""
        return self

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        return (history_part(self.observations, self.actions, size),)


@settings
class ResidualAction(Hybrid):
    """Hybrid whose policy corrects the base controller's action, equation (2) (residual policy learning).

    The policy observes the base controller's estimates and its action. With a = 0 the base controller acts alone.
    """

    kind: ClassVar[str] = "residual_action"
    base_controller: Any = "flatness"  # a name from `quadpend_baselines.CONTROLLERS`, or a controller
    action_scale: Annotated[float, Range(1e-6, 3.0)] = 0.3  # κ

    def parts(self, size: int) -> tuple[InputPart, ...]:
        """Return the parts of the policy's observation; see `Hybrid.parts`."""
        if self.controller.observer == "kalman":
            state = estimated_part("estimate", self._vehicle.rod_length, MAGNIFICATION)
        else:
            state = observed_part(size, MAGNIFICATION)
        return state, disturbance_part(self._vehicle.hover_thrust), base_action_part()

    def _first_action(self, updated: Any, rows: int) -> tuple[Floats32, Any]:
        action, after = self.controller.control(updated)
        return action, after

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the action on which the policy builds; see `Hybrid.base_action`."""
        return memory.base_action, memory

    def _applied(self, action: Floats32, base_action: Floats32) -> Floats32:
        return np.clip(base_action + np.float32(self.action_scale) * action, -1.0, 1.0)


HYBRIDS: dict[str, type[Hybrid]] = {
    kind.kind: kind for kind in (EstimateOnly, MemoryOnly, LabOnly, HistoryOnly, ResidualAction)
}


def hybrid_from_data(data: Any) -> Hybrid:
    """Return the hybrid that plain data describe, such as ``{"kind": "estimate_only", "base_controller": "lqr"}``."""
    kind = HYBRIDS.get(str(data.get("kind"))) if isinstance(data, Mapping) else None
    if kind is None or (kind is not HistoryOnly and not isinstance(data.get("base_controller"), str)):
        raise ValueError(
            f"a hybrid must be a mapping with a kind, one of {', '.join(HYBRIDS)}, and the name of a base_controller,"
            f" not {data!r}"
        )
    gone = {"kind": data["kind"], "fallback_gain": 0.0}  # the latter in files of version 0.3
    return parse(kind, {name: value for name, value in data.items() if gone.get(name) != value}, "hybrid")
