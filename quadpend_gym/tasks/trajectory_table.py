"""The trajectories that the sub-environments of a `World` follow, packed for compiled functions."""

from collections.abc import Sequence

import numpy as np

from quadpend_gym.core.arrays import Integers
from quadpend_gym.tasks.trajectories import Sinusoids, Waypoints

Packed = Waypoints | Sinusoids


class TrajectoryTable:
    """Trajectories of n sub-environments, of which each object is stored once.

    Args:
        rows: Number n of sub-environments.

    Attributes:
        numbers: Packed trajectories, one after the other, see `quadpend_gym.tasks.trajectories`.
        first: Position in `numbers` of the trajectory of each sub-environment, shape (n,); −1: it follows none.
        in_use: Whether a sub-environment follows one.
    """

    def __init__(self, rows: int) -> None:
        """Begin without trajectories."""
        self.numbers = np.zeros(0)
        self.first = np.full(rows, -1, np.int64)
        self.in_use = False
        self._followed: list[Packed | None] = [None] * rows

    def assign(self, rows: Integers, trajectories: Sequence[Packed | None]) -> None:
        """Set the trajectories of some sub-environments.

        Args:
            rows: Indices of the sub-environments, shape (m,).
            trajectories: One trajectory for all of them or one for each; None for a sub-environment without one.
        """
        new = list(trajectories) * (len(rows) // len(trajectories))
        if all(self._followed[row] is item for row, item in zip(rows, new, strict=True)):
            return
        for row, item in zip(rows, new, strict=True):
            self._followed[row] = item
        distinct = {id(item): item.packed for item in self._followed if item is not None}
        ends = np.cumsum([0, *(packed.size for packed in distinct.values())])
        position = dict(zip(distinct, ends.tolist(), strict=False))
        self.first[:] = [position.get(id(item), -1) for item in self._followed]
        self.numbers = np.concatenate([np.zeros(0), *distinct.values()])
        self.in_use = bool(distinct)

    def find(self, row: int) -> Packed | None:
        """Return the trajectory of a sub-environment, or None if it follows none."""
        return self._followed[row]
