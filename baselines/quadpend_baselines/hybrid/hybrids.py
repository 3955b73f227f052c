"""Hybrids of a classical base controller and a policy.

At every control step a hybrid first computes the policy's observation (`Hybrid.observe`), and then computes the action
that is applied to the environment from the policy's action (`Hybrid.act`). The classes use the policy's action
a ∈ [−1, 1]⁴ in different ways, with the action scale κ:

| class            | applied action                                                                                   |
|------------------|--------------------------------------------------------------------------------------------------|
| `EstimateOnly`   | (1)  a                                                                                           |
| `MemoryOnly`     | (1)  a; the base controller does not fly: it is the teacher                                      |
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
has the inputs of `memory` alone.

`ResidualAction` multiplies the part of the observation that depends on the state, and the base controller's action, by
ten, because the base controller keeps these values small.
"""

from collections.abc import Mapping
from copy import copy
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.lqg import Lqg
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.deviations import DEVIATION_SIZE, deviation_inputs
from quadpend_baselines.hybrid.innovations import (
    FILTERED_SIZE,
    INNOVATIONS_SIZE,
    TIMES,
    filter_shares,
    innovation_inputs,
    last_filtered,
)
from quadpend_baselines.hybrid.memory import MEMORY_SIZE, memory_inputs, memory_numbers
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, situation_inputs, update_situation
from quadpend_baselines.registry import controller
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.settings import Range, parse, settings
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import (
    FULL,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK,
    REFERENCE_START,
    ObservationLayout,
)
from quadpend_gym.vehicles import CONTROL_PERIOD

ActionScale = Annotated[float, Range(1e-6, 3.0)]  # κ
_MAGNIFICATION = np.float32(10.0)  # factor on small deviations in the policy's observation


class HybridMemory(NamedTuple):
    """The state of a hybrid between two calls, for n rows."""

    controller: Any  # memory of the base controller
    base_action: Floats32  # action of the base controller, (n, 4); zeros if the hybrid computes it later
    situation: Any = ()  # `Situation`; empty for hybrids that do not observe it
    filtered: Any = ()  # f of `innovations` or `memory`; empty for hybrids that do not observe it
    action: Any = ()  # the last applied action, for `memory`


class Hybrid:
    """A base controller combined with a policy."""

    kind: ClassVar[str]  # the key of the class in `HYBRIDS`
    _base_acts_first: ClassVar[bool] = False  # whether the base controller acts even if it has a Kalman observer
    base_controller: Any  # as it was given: one of `quadpend_baselines.CONTROLLERS`, or an object
    controller: Any  # the base controller, which estimates the disturbance

    def __post_init__(self) -> None:
        given = self.base_controller
        found = controller(given) if isinstance(given, str) else given
        if not isinstance(found, ADRC | OutputFeedback):
            raise ValueError(f"base_controller must be a controller that estimates the disturbance, not {given!r}")
        object.__setattr__(self, "controller", found)

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid with its base controller designed for another nominal simulation and loop."""
        other = copy(self)
        object.__setattr__(other, "controller", self.controller.designed_for(simulation, loop))
        return other

    def flown_in(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid as a policy needs it to fly in a nominal simulation with a known loop."""
        return self.designed_for(simulation, loop)

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation if the environment's observation has `size` numbers."""
        return (OBSERVATION_SIZE if isinstance(self.controller, OutputFeedback) else size) + DISTURBANCE_SIZE

    def observe(self, observation: Floats32, memory: Any, episode_start: Any) -> tuple[Floats32, HybridMemory]:
        """Update the base controller's estimate and make the policy's observation.

        Args:
            observation: Observation of the environment, shape (n, 36) or (n, 27).
            memory: Memory that the last call of `act` returned; None at the first step.
            episode_start: Mask of the rows whose episode begins with this observation, shape (n,).

        Returns:
            The policy's observation, shape (n, m) with m from `observation_size`, and the memory for `act`.
        """
        raise NotImplementedError

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the action that the base controller would apply, shape (n, 4), and the memory after that, for `act`.

        Base controllers with an integral or a plan expect this call in every step.

        `memory` is that which the last call of `observe` returned.
        """
        return memory.base_action, memory

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Turn the policy's action into the action to apply, and pass the latter to the base controller's observer.

        Args:
            action: Action of the policy, shape (n, 4).
            memory: Memory that the last call of `observe` or `base_action` returned.

        Returns:
            The action to apply to the environment, shape (n, 4), and the memory for the next call of `observe`.
        """
        raise NotImplementedError

    def _update(self, observation: Floats32, memory: HybridMemory | None, started: Any) -> tuple[Floats32, Any]:
        """Return zeros and the estimation of a base controller that acts later, or else its action and memory."""
        last = None if memory is None else memory.controller
        if isinstance(self.controller, OutputFeedback) and not self._base_acts_first:
            zeros = np.zeros((len(observation), ACTION_SIZE), np.float32)
            return zeros, self.controller.update(observation, last, started)
        action, after = self.controller.predict(observation, last, started)
        return action, after

    def _applied(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the applied action, and the memory of an observer that knows it."""
        return action, memory._replace(controller=self.controller.with_applied_action(memory.controller, action))


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
        if self.deviations and not isinstance(getattr(self.controller, "_law", None), Lqg):
            raise ValueError(f"deviations needs the base_controller lqg, not {self.base_controller!r}")
        if (self.situation or self.innovations) and not isinstance(self.controller, OutputFeedback):
            raise ValueError(
                f"situation and innovations need a base_controller with a Kalman observer, not {self.base_controller!r}"
            )

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation; see `Hybrid.observation_size`."""
        known = DEVIATION_SIZE if self.deviations else super().observation_size(size)
        return known + self.situation * SITUATION_SIZE + self.innovations * INNOVATIONS_SIZE

    def observe(self, observation: Floats32, memory: Any, episode_start: Any) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`."""
        base, (action, updated) = self.controller, self._update(observation, memory, episode_start)
        disturbance, rows, started = base.estimated_disturbance(updated), len(observation), episode_start
        situation: Any = ()
        filtered: Any = ()
        if self.deviations:
            observed: list[Any] = [deviation_inputs(base._law, base.predicted_estimate(updated))]
        else:
            known = base.predicted_observation(updated) if isinstance(base, OutputFeedback) else observation
            observed = [known, disturbance]
        if self.situation:
            last, innovation = None if memory is None else memory.situation, updated.estimate.innovation
            situation = update_situation(last, started, innovation, disturbance, base.simulation.period)
            observed.append(situation_inputs(situation))
        if self.innovations:
            last = last_filtered(None if memory is None else memory.filtered, started, rows)
            observed.append(innovation_inputs(updated.estimate, last, filter_shares(base.simulation.period, TIMES)))
            filtered = observed[-1][:, -FILTERED_SIZE:]
        seen = np.concatenate(observed, axis=1, dtype=np.float32)
        return seen, HybridMemory(updated, action, situation, filtered)

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the base controller's action, which only imitation needs; see `Hybrid.base_action`."""
        return _late_action(self.controller, memory)

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the policy's action unchanged and the memory; see `Hybrid.act`."""
        return self._applied(action, memory)


@settings
class MemoryOnly(Hybrid):
    """Hybrid whose policy acts alone, equation (1), on the measurements and a memory of them, see `memory`.

    It gets no parameters of its vehicle. The base controller is its teacher, which only `designed_for` adds.
    """

    kind: ClassVar[str] = "memory_only"
    base_controller: Any = "lqg"  # a name from `quadpend_baselines.CONTROLLERS`, or a controller
    period: ClassVar[float] = CONTROL_PERIOD  # s, of the simulation that it is made for
    observed: ClassVar[ObservationLayout] = FULL  # fields of the observations
    teacher: ClassVar[Any] = None  # the base controller, which `controller` is while it teaches

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "teacher", self.controller)
        object.__setattr__(self, "controller", None)

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid with a teacher for a simulation and loop."""
        other = self.flown_in(simulation, loop)
        object.__setattr__(other, "controller", self.teacher.designed_for(simulation, loop))
        return other

    def flown_in(self, simulation: Simulation, loop: Loop | None = None) -> "Hybrid":
        """Return this hybrid without its teacher; see `Hybrid.flown_in`."""
        other = copy(self)
        object.__setattr__(other, "period", simulation.period)
        object.__setattr__(other, "observed", (loop or Loop()).observation)
        object.__setattr__(other, "controller", None)
        return other

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation, 92."""
        return MEMORY_SIZE

    def observe(self, observation: Floats32, memory: Any, episode_start: Any) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`."""
        rows, started = len(observation), episode_start
        none, filtered = np.zeros((rows, ACTION_SIZE), np.float32), None
        action = none
        if memory is not None:
            action, filtered = np.where(started[:, np.newaxis], none, memory.action), memory.filtered
        base_action, teacher = (none, ()) if self.controller is None else self._update(observation, memory, started)
        self.observed.check(observation)
        given = (
            observation[:, self.observed.select(OUTPUT_FEEDBACK)].astype(np.float64),
            action.astype(np.float64),
            filtered,
            started,
        )
        seen, filtered = memory_inputs(*given, memory_numbers(self.period))
        return seen.astype(np.float32), HybridMemory(teacher, base_action, (), filtered, action)

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the teacher's action; see `Hybrid.base_action`."""
        if self.controller is None:
            raise ValueError("a hybrid that was made for a flight has no teacher: ask for one with teaches=True")
        return _late_action(self.controller, memory)

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the policy's action unchanged and the memory; see `Hybrid.act`."""
        applied, after = (action, memory) if self.controller is None else self._applied(action, memory)
        return applied, after._replace(action=action)


@settings
class ResidualAction(Hybrid):
    """Hybrid whose policy corrects the base controller's action, equation (2) (residual policy learning).

    The policy observes the base controller's estimates and its action. With a = 0 the base controller acts alone.
    """

    kind: ClassVar[str] = "residual_action"
    _base_acts_first: ClassVar[bool] = True
    base_controller: Any = "flatness"  # a name from `quadpend_baselines.CONTROLLERS`, or a controller
    action_scale: ActionScale = 0.3

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation; see `Hybrid.observation_size`."""
        return super().observation_size(size) + ACTION_SIZE

    def observe(self, observation: Floats32, memory: Any, episode_start: Any) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`."""
        base, (action, updated) = self.controller, self._update(observation, memory, episode_start)
        known = base.estimated_observation(updated) if isinstance(base, OutputFeedback) else observation.copy()
        known[:, : REFERENCE_START - OBSERVATION_SIZE] *= _MAGNIFICATION
        parts = [known, base.estimated_disturbance(updated), _MAGNIFICATION * action]
        return np.concatenate(parts, axis=1, dtype=np.float32), HybridMemory(updated, action)

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the corrected action and the memory; see `Hybrid.act`."""
        return self._applied(np.clip(memory.base_action + np.float32(self.action_scale) * action, -1.0, 1.0), memory)


def _late_action(base: Any, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
    """Return the action of a base controller that has only estimated so far, and the memory with it."""
    if not isinstance(base, OutputFeedback):
        return memory.base_action, memory
    action, updated = base.control(memory.controller)
    return action, memory._replace(controller=updated)


HYBRIDS: dict[str, type[Hybrid]] = {kind.kind: kind for kind in (EstimateOnly, MemoryOnly, ResidualAction)}


def hybrid_from_data(data: Any) -> Hybrid:
    """Return the hybrid that plain data describe, such as ``{"kind": "estimate_only", "base_controller": "lqr"}``."""
    kind = HYBRIDS.get(str(data.get("kind"))) if isinstance(data, Mapping) else None
    if kind is None or not isinstance(data.get("base_controller"), str):
        raise ValueError(
            f"a hybrid must be a mapping with a kind, one of {', '.join(HYBRIDS)}, and the name of a base_controller,"
            f" not {data!r}"
        )
    gone = {"kind": data["kind"], "fallback_gain": 0.0}  # the latter in files of version 0.3
    return parse(kind, {name: value for name, value in data.items() if gone.get(name) != value}, "hybrid")
