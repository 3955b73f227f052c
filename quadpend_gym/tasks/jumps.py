"""Jumps of the reference: it moves at once to a random side and later back, in turn."""

from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.events import Events, next_events, take_due
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.tasks.references import CHANNELS


@settings
class Jumps(Events):
    """Jumps of the reference's position and yaw; its derivatives do not change."""

    # horizontal distance of a jump, uniform in this interval, to a random side
    distance: Annotated[Interval, Range(0.0, 1000.0, "m")] = (0.0, 0.0)
    yaw: Annotated[Interval, Range(0.0, np.pi, "rad")] = (0.0, 0.0)  # angle of a jump, to the left or to the right
    # time before each jump, out or back, uniform in this interval; a control period has at most one jump
    pause: Annotated[Interval, Range(0.001, 1e6, "s")] = (2.0, 3.0)
    memory_size = 3 + CHANNELS  # of `core.events` with a length of 0, around the offset after the jump

    def __post_init__(self) -> None:
        if self.distance[1] == 0.0 and self.yaw[1] == 0.0:
            raise ValueError("jumps must have a distance or a yaw above zero")

    def _draw_next(self, memory: Floats, ended: Any, streams: Streams) -> None:
        bounds = (0.0, 0.0), self.distance, (-np.pi, np.pi), self.yaw, (-1.0, 1.0)
        distance, heading, yaw, side = next_events(memory, ended, streams, self.pause, *bounds)
        half = 0.5 * memory[ended, -1]
        out = 1.0 - 2.0 * (half - np.floor(half))  # 0 for a jump back
        x, y = out * distance * np.cos(heading), out * distance * np.sin(heading)
        memory[ended, 2:-1] = np.stack([x, y, 0.0 * x, out * np.where(side < 0.0, -yaw, yaw)], axis=1)

    def jump(self, offset: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Let the references jump whose time has come at the control step `step`, shape (n,).

        `offset`, shape (n, 4), is that of the channels (F_x, F_y, z, ψ) from the reference without jumps.
        """
        offset[:] = take_due(memory, (step + 0.5) * period, streams, self._draw_next, offset)
