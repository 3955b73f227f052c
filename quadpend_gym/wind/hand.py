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
from quadpend_gym.core.settings import Range, settings
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
    distance: Annotated[float, Range(0.0, 100.0, "m")] = 0.05  # of the hand from `point`
    point: Annotated[tuple[float, float], Range(-1e4, 1e4, "m")] = (0.0, 0.0)  # x and y in the world
    until: Annotated[float, Range(0.0, 1e6, "s")] = 3.0  # time when the hand lets go
    kind: Literal["hold"] = "hold"
    memory_size = 2  # position of the hand, m
    moves_air = False
    holds = True

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the side of the hand."""
        side = 2.0 * np.pi * streams.uniform(0, 1)
        return np.asarray(self.distance * np.hstack([np.cos(side), np.sin(side)]) + self.point)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the hand of control periods whose middle is before `until`."""
        held = np.where((step + 0.5) * period < self.until, 1.0, 0.0)[:, np.newaxis]
        out[:, HAND] += held * np.hstack(
            [self.stiffness * memory, np.broadcast_to((self.stiffness, self.damping), memory.shape)]
        )
