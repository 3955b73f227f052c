"""Discrete gusts: one-minus-cosine gusts at random times, and the random gusts of the paper."""

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.events import Events, next_events, present_events
from quadpend_gym.core.models import Stateless
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind.base import LARGEST_LOAD, WIND_FIELDS, WINDS, WORLD_VECTORS, Addable, Load, Loads, add_rotated

__all__ = ["Gusts", "PaperGusts"]


@WINDS.add
@settings
class Gusts(Events, Loads):
    """A sequence of one-minus-cosine gusts with pauses between them.

    A gust with onset t₀ and length T is load · ½ (1 − cos 2π (t − t₀)/T), rotated about the vertical by its heading.
    This is the discrete gust of MIL-F-8785C followed by its mirror image. The loads are peak values. Pause, length and
    heading are drawn for each gust; an episode begins with a pause.
    """

    pause: Annotated[Interval, Range(0.0, 1e6, "s")] = (0.5, 3.0)  # time before each gust, uniform in this interval
    # duration of each gust, uniform in this interval, at least 0.01
    length: Annotated[Interval, Range(0.01, 1e6, "s")] = (0.5, 2.0)
    # rotation of the loads from x towards y in each gust, uniform in this interval
    heading: Annotated[Interval, Range(-1000.0, 1000.0, "rad")] = (-np.pi, np.pi)
    kind: Literal["gusts"] = "gusts"
    memory_size = 5  # onset (s), length (s), cosine and sine of the heading, and number of the current or next gust

    def __post_init__(self) -> None:
        if self.load[WIND_FIELDS["torque"]].any():
            raise ValueError(
                "torque must be 0 for gusts: the heading of a gust rotates world-frame vectors, and a torque is not one"
            )

    def _draw_next(self, memory: Floats, ended: Any, streams: Streams) -> None:
        """Draw the next gust of the sub-environments `ended`, a boolean mask of shape (n,)."""
        (heading,) = next_events(memory, ended, streams, self.pause, self.length, self.heading)
        memory[ended, 2], memory[ended, 3] = np.cos(heading), np.sin(heading)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the value in the middle of the control period, which is constant during the period."""
        time = (step + 0.5) * period
        present_events(memory, time, streams, self._draw_next)
        onset, length, cosine, sine = memory[:, :4].T
        phase = np.maximum(time - onset, 0.0) / length
        shape = 0.5 - 0.5 * np.cos(2.0 * np.pi * phase)
        for axis in WORLD_VECTORS:
            if self.load[axis : axis + 3].any():
                add_rotated(out, axis, self.load[axis : axis + 3], shape, cosine, sine)


@WINDS.add
@settings
class PaperGusts(Stateless, Addable):
    """The random gusts of the paper's Section 5, in x, y, z and yaw.

    The disturbance is zero until the onset. The paper's onset is 10 s, the usual length of an episode. The paper gives
    neither shape nor size of the gusts. Here a new target is drawn every `hold` seconds, uniformly between minus and
    plus the amplitude, and the disturbance moves to the target along half a period of a cosine. As a function of time
    it is bounded and differentiable, as the paper's Theorem 1 assumes; each control period has one sample of it.
    """

    force: Annotated[Load, Range(0.0, LARGEST_LOAD, "N")] = 0.3  # amplitude of the force on the quadrotor
    yaw_torque: Annotated[float, Range(0.0, LARGEST_LOAD, "N·m")] = 0.05  # amplitude of the yaw torque
    onset: Annotated[float, Range(0.0, 1e6, "s")] = 10.0  # time of the first gust
    hold: Annotated[float, Range(1e-3, 1e6, "s")] = 1.0  # time from one target to the next
    kind: Literal["paper_gusts"] = "paper_gusts"
    moves_air = False

    @cached_property
    def amplitude(self) -> Floats:
        """Amplitudes of the force in x, y, z (N) and of the yaw torque (N·m), shape (4,)."""
        return np.append(np.broadcast_to(self.force, 3), self.yaw_torque)

    def _target(self, number: Integers, streams: Streams) -> Floats:
        """Return the targets with these numbers, shape (n, 4); target 0 is zero."""
        unit = 2.0 * streams.uniform(number, 4) - 1.0
        return np.where(number[:, np.newaxis] > 0, self.amplitude * unit, 0.0)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the value in the middle of the control period, which is constant during the period."""
        phase = np.maximum((step + 0.5) * period - self.onset, 0.0) / self.hold
        number = np.floor(phase).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * (phase - number))[:, np.newaxis]
        strength = (1.0 - blend) * self._target(number, streams) + blend * self._target(number + 1, streams)
        yaw = WIND_FIELDS["torque"].stop - 1
        for column, axis in enumerate((0, 1, 2, yaw)):
            out[:, axis] += strength[:, column]
