"""A classical controller that flies along with a learner: the learner sees what it knows, and may steer it.

The learner observes, side by side,

| what                                                                                  | size | scale   |
|---------------------------------------------------------------------------------------|------|---------|
| the observation; where the controller estimates the whole state, as it estimates it   | 36   | its own |
| the disturbance that it estimates, laid out as ``info["disturbance"]``                | 9    | 1 N, 1 N·m |
| its action, where the learner corrects it                                             | 4    | 1       |

and where it steers, it sees what comes of the state and the controller's action ten times as large, since it works
close to the reference. What its action a ∈ [−1, 1]⁴ means is one of

    (1)  alone     a acts
    (2)  action    clip(a_controller + κ a, −1, 1) acts
    (3)  pace      the controller acts, its four bandwidths times (1 + κ)^a     position, pendulum, attitude, height

with the authority κ. The controller's observer is told what really acted, whoever asked for it.
"""

from typing import Any, NamedTuple

import numpy as np

from baselines.observed import Observed
from baselines.policy import placed
from quadpend_gym.arrays import Floats32, Integers
from quadpend_gym.kernel import DISTURBANCE_SIZE
from quadpend_gym.observation import OBSERVATION_SIZE, STATE_PART
from quadpend_gym.records import number

STEERS = ("alone", "action", "pace")
_CLOSE = np.float32(10.0)  # how much larger small deviations are seen


class CompanionMemory(NamedTuple):
    """What a companion remembers from one call to the next, for n rows."""

    controller: Any  # the controller's own memory, or what it knows
    action: Floats32  # that the controller would take, (n, 4); of no meaning where it is not asked


class Companion:
    """A controller beside a learner.

    Args:
        controller: a classical controller with an observer: `ADRC` or one of `Observed`; with a pace, `flatness`.
        steers: what the learner steers, one of `STEERS`.
        authority: κ of equations (2) and (3), in (0, 3].

    Raises:
        TypeError: the controller estimates no disturbance, or has no pace.
        ValueError: there is no such thing to steer, or the authority is out of range.
    """

    def __init__(self, controller: Any, steers: str = "alone", authority: float = 1.0) -> None:
        """Seat the controller beside the learner."""
        if not hasattr(controller, "estimated_disturbance"):
            raise TypeError(f"a companion must be a controller that estimates the disturbance, not {controller!r}")
        if steers not in STEERS:
            raise ValueError(f"steers must be one of {', '.join(STEERS)}, not {steers!r}")
        if number(authority, "authority", 0.0, 3.0) == 0.0:
            raise ValueError("authority must be above zero")
        self._whole = isinstance(controller, Observed)
        if steers == "pace" and not (self._whole and controller.has_pace):
            raise TypeError(f"only the flatness-based controller has a pace, not {controller!r}")
        self.controller, self.steers, self.authority = controller, steers, authority

    def watch(self, observation: Floats32, memory: CompanionMemory | None, started: Any) -> tuple[Any, CompanionMemory]:
        """What the learner sees, shape (n, `size`), and what is remembered.

        Args:
            observation: shape (n, 36) or (n, 27).
            memory: what `act` returned; None at first.
            started: rows whose episode has just begun, shape (n,).
        """
        before = None if memory is None else memory.controller
        action = np.zeros((len(observation), 4), np.float32)
        if self.steers == "pace":
            known = self.controller.observe(observation, before, started)
        else:
            action, known = self.controller.predict(observation, before, started)
        seen = self.controller.estimated_observation(observation, known) if self._whole else observation.copy()
        if self.steers != "alone":
            seen[:, : STATE_PART - OBSERVATION_SIZE] *= _CLOSE
        parts = [seen, self.controller.estimated_disturbance(known)]
        if self.steers == "action":
            parts.append(_CLOSE * action)
        return np.concatenate(parts, axis=1, dtype=np.float32), CompanionMemory(known, action)

    def act(self, action: Floats32, memory: CompanionMemory) -> tuple[Floats32, CompanionMemory]:
        """What acts if the learner's action is `action`, shape (n, 4), and what is remembered."""
        if self.steers == "pace":
            pace = (1.0 + self.authority) ** action.astype(np.float64)
            acting, known = self.controller.decide(memory.controller, pace=pace)
            return acting, CompanionMemory(known, acting)
        if self.steers == "action":
            action = np.clip(memory.action + np.float32(self.authority) * action, -1.0, 1.0)
        return action, memory._replace(controller=self.controller.acted(memory.controller, action))

    def size(self, observations: int) -> int:
        """How many numbers the learner sees of an observation of so many."""
        seen = OBSERVATION_SIZE if self._whole else observations
        return seen + DISTURBANCE_SIZE + (4 if self.steers == "action" else 0)

    @staticmethod
    def restarted(rows: Integers, fresh: CompanionMemory, memory: CompanionMemory) -> CompanionMemory:
        """`memory` but that some of its rows are those of `fresh`."""
        placed_memory: CompanionMemory = placed(rows, fresh, memory)
        return placed_memory
