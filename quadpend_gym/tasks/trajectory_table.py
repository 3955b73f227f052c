"""The trajectories that the sub-environments of a `World` follow, packed for compiled functions."""

from collections.abc import Sequence

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.tasks.trajectories import Sinusoids, Waypoints

Packed = Waypoints | Sinusoids


class TrajectoryTable:
    """Trajectories of n sub-environments. Equal ones are stored once, and unused ones are removed from time to time.

    Args:
        rows: Number n of sub-environments.

    Attributes:
        numbers: Packed trajectories, one after the other, see `quadpend_gym.tasks.trajectories`.
        first: Position in `numbers` of the trajectory of each sub-environment, shape (n,); −1: it follows none.
        in_use: Whether a sub-environment follows one.
    """

    def __init__(self, rows: int) -> None:
        """Begin without trajectories."""
        self.numbers = self._none = np.zeros(0)
        self.first = np.full(rows, -1, np.int64)
        self.in_use = False
        self._positions: dict[Packed, int] = {}

    @property
    def active(self) -> Floats:
        """The numbers, empty if no sub-environment follows a trajectory."""
        return self.numbers if self.in_use else self._none

    def assign(self, rows: Integers, trajectories: Sequence[Packed | None]) -> None:
        """Set the trajectories of some sub-environments.

        Args:
            rows: Indices of the sub-environments, shape (m,).
            trajectories: One trajectory for all of them or one for each; None for a sub-environment without one.
        """
        if not self.in_use and all(item is None for item in trajectories):
            return
        self.first[rows] = -1
        wanted = [item for item in dict.fromkeys(trajectories) if item is not None]
        if len(self._positions.keys() | set(wanted)) > 2 * self.first.size:
            self._remove_unused()
        self._append([item for item in wanted if item not in self._positions])
        positions = [-1 if item is None else self._positions[item] for item in trajectories]
        self.first[rows] = positions if len(positions) > 1 else positions[0]
        self.in_use = bool((self.first >= 0).any())

    def find(self, row: int) -> Packed | None:
        """Return the trajectory of a sub-environment, or None if it follows none."""
        return next((item for item, position in self._positions.items() if position == self.first[row]), None)

    def _append(self, new: Sequence[Packed]) -> None:
        position = self.numbers.size
        for item in new:
            self._positions[item] = position
            position += item.packed.size
        self.numbers = np.concatenate([self.numbers, *(item.packed for item in new)])

    def _remove_unused(self) -> None:
        before, used = self.first.copy(), set(self.first.tolist())
        kept = {item: position for item, position in self._positions.items() if position in used}
        self._positions, self.numbers = {}, np.zeros(0)
        self._append(list(kept))
        for item, position in kept.items():
            self.first[before == position] = self._positions[item]
