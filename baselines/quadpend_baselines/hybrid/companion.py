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

With a caution γ > 0 it is c a that acts and not a: the learner is trusted less where the observer sees a torque, which
actuators that answer late look like (wind exerts hardly any), or where the pendulum leans far from upright. The doubt q
fades within a second; the learner does not observe it. In control step k of 10 ms

    (4)  c_k = 1/(1 + γ² q_k²),    q_k = max(|τ̂_k|/(0.5 N·m), |r_xy|/0.2, 0.99 q_{k−1}).
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.policy.protocol import replace_rows
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.validation import check_number
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, REFERENCE_START, read_observation

STEERS = ("alone", "action", "pace")
_CLOSE = np.float32(10.0)  # how much larger small deviations are seen
# Equation (4)
_TORQUE, _LEAN, _KEPT = 0.5, 0.2, 0.99
_TORQUES = slice(DISTURBANCE_SIZE - 3, DISTURBANCE_SIZE)


class CompanionMemory(NamedTuple):
    """What a companion remembers from one call to the next, for n rows."""

    controller: Any  # the controller's own memory, or what it knows
    action: Floats32  # that the controller would take, (n, 4); of no meaning where it is not asked
    doubt: Floats  # q of equation (4), (n,); zero without caution


class Companion:
    """A controller beside a learner.

    Args:
        controller: a classical controller with an observer: `ADRC` or one of `Observed`; with a pace, `flatness`.
        steers: what the learner steers, one of `STEERS`.
        authority: κ of equations (2) and (3), in (0, 3].
        caution: γ of equation (4), in [0, 10]; 0: the learner is always trusted.

    Raises:
        TypeError: the controller estimates no disturbance, or has no pace.
        ValueError: there is no such thing to steer, the authority or the caution is out of range, or there is caution
            about a learner that acts alone.
    """

    def __init__(self, controller: Any, steers: str = "alone", authority: float = 1.0, caution: float = 0.0) -> None:
        """Seat the controller beside the learner."""
        if not hasattr(controller, "estimated_disturbance"):
            raise TypeError(f"a companion must be a controller that estimates the disturbance, not {controller!r}")
        if steers not in STEERS:
            raise ValueError(f"steers must be one of {', '.join(STEERS)}, not {steers!r}")
        if check_number(authority, "authority", 0.0, 3.0) == 0.0:
            raise ValueError("authority must be above zero")
        if check_number(caution, "caution", 0.0, 10.0) > 0.0 and steers == "alone":
            raise ValueError(
                f"a learner that acts alone has no controller to fall back on: caution must be 0, not {caution:g}"
            )
        self._whole = isinstance(controller, OutputFeedback)
        if steers == "pace" and not (self._whole and controller.has_bandwidth_scale):
            raise TypeError(f"only the flatness-based controller has a pace, not {controller!r}")
        self.controller, self.steers, self.authority, self.caution = controller, steers, authority, caution

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
            known = self.controller.update(observation, before, started)
        else:
            action, known = self.controller.predict(observation, before, started)
        seen = self.controller.estimated_observation(observation, known) if self._whole else observation.copy()
        disturbance = self.controller.estimated_disturbance(known)
        doubt = self._doubt(seen, disturbance, memory, started) if self.caution else np.zeros(len(seen))
        if self.steers != "alone":
            seen[:, : REFERENCE_START - OBSERVATION_SIZE] *= _CLOSE
        parts = [seen, disturbance]
        if self.steers == "action":
            parts.append(_CLOSE * action)
        return np.concatenate(parts, axis=1, dtype=np.float32), CompanionMemory(known, action, doubt)

    def act(self, action: Floats32, memory: CompanionMemory) -> tuple[Floats32, CompanionMemory]:
        """What acts if the learner's action is `action`, shape (n, 4), and what is remembered."""
        if self.caution:
            trust = 1.0 / (1.0 + (self.caution * memory.doubt) ** 2)
            action = (trust[:, np.newaxis] * action).astype(np.float32)
        if self.steers == "pace":
            pace = (1.0 + self.authority) ** action.astype(np.float64)
            acting, known = self.controller.control(memory.controller, bandwidth_scale=pace)
            return acting, CompanionMemory(known, acting, memory.doubt)
        if self.steers == "action":
            action = np.clip(memory.action + np.float32(self.authority) * action, -1.0, 1.0)
        return action, memory._replace(controller=self.controller.with_applied_action(memory.controller, action))

    def size(self, observations: int) -> int:
        """How many numbers the learner sees of an observation of so many."""
        seen = OBSERVATION_SIZE if self._whole else observations
        return seen + DISTURBANCE_SIZE + (4 if self.steers == "action" else 0)

    @staticmethod
    def _doubt(seen: Floats32, disturbance: Floats, memory: CompanionMemory | None, started: Any) -> Floats:
        """Equation (4)'s q, shape (n,)."""
        lean = np.linalg.norm(read_observation(seen, "direction")[:, :2], axis=1) / _LEAN
        doubt = np.maximum(np.linalg.norm(disturbance[:, _TORQUES], axis=1) / _TORQUE, lean)
        if memory is not None:
            doubt = np.where(started, doubt, np.maximum(doubt, _KEPT * memory.doubt))
        return np.asarray(doubt)

    @staticmethod
    def restarted(rows: Integers, fresh: CompanionMemory, memory: CompanionMemory) -> CompanionMemory:
        """`memory` but that some of its rows are those of `fresh`."""
        placed_memory: CompanionMemory = replace_rows(rows, fresh, memory)
        return placed_memory
