"""A hand that holds the upper end of the pole, and lets it go.

With the pole's upper end at the position y, L from the pivot, and at the distance l of its centre of mass, the hand
pulls horizontally with

    (1)  F = k (x − y) − c ẏ

A force at the upper end acts on the rigid pole as (L/l) F at its centre of mass and (1 − L/l) F at the pivot: the sum
and the moment about the pivot are the same. `quadpend_gym.physics.rigid_kernel` evaluates F in each substep. The
paper's attitude model has no hand.
"""

from typing import Annotated, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind.base import HAND, WINDS, Addable

__all__ = ["Hold"]


@WINDS.add
@settings
class Hold(Addable):
    """A hand that holds the pole's upper end from the beginning of an episode, and lets it go, equation (1).

    The hand is at `distance` from `point`, on a side that is drawn for each episode. The pole goes on with the velocity
    that it has.
    """

    stiffness: Annotated[float, Range(0.0, 1000.0, "N/m")] = 20.0  # k
    damping: Annotated[float, Range(0.0, 20.0, "N·s/m")] = 0.5  # c
    # of the hand from `point`; of two numbers, uniform in this interval and drawn for each episode
    distance: Annotated[float | Interval, Range(0.0, 100.0, "m")] = 0.05
    point: Annotated[tuple[float, float], Range(-1e4, 1e4, "m")] = (0.0, 0.0)  # x and y in the world
    # time when the hand lets go; of two numbers, drawn like `distance`
    until: Annotated[float | Interval, Range(0.0, 1e6, "s")] = 3.0
    kind: Literal["hold"] = "hold"
    memory_size = 3  # position of the hand (m), and the time when it lets go (s)
    moves_air = False
    holds = True

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the position of the hand and the time when it lets go."""
        drawn = (0.0, 2.0 * np.pi), self.distance, self.until
        lowest, highest = np.stack([np.broadcast_to(bounds, 2) for bounds in drawn], axis=1)
        side, distance, until = np.split(streams.between(0, lowest, highest), 3, axis=1)
        return np.hstack([distance * np.hstack([np.cos(side), np.sin(side)]) + self.point, until])

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the hand of control periods whose middle is before `until`."""
        place, held = memory[:, :2], np.where((step + 0.5) * period < memory[:, 2], 1.0, 0.0)[:, np.newaxis]
        out[:, HAND] += held * np.hstack(
            [self.stiffness * place, np.broadcast_to((self.stiffness, self.damping), place.shape)]
        )
