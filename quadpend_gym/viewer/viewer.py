"""What an environment shows in each render mode."""

from collections.abc import Sequence
from typing import Any

import pygame

from quadpend_gym.film import Snapshot
from quadpend_gym.viewer.picture import SIZE, Picture


class Viewer:
    """Shows snapshots as arrays or in a window.

    Args:
        mode: ``human``, ``rgb_array`` or ``mosaic``.
        period: s, between two steps.
    """

    def __init__(self, mode: str, period: float) -> None:
        """Open a window, if the mode wants one."""
        self.picture = Picture()
        self._mode = mode
        self._window: Any = None
        if mode == "human":
            from quadpend_gym.viewer.window import Window

            self._window = Window(self.picture, period)
        else:
            self._surface = pygame.Surface(SIZE)

    @property
    def over(self) -> bool:
        """Whether whoever watches wants the episode to end: to start again, or because the window is closed."""
        return self._window is not None and self._window.over

    @property
    def closed(self) -> bool:
        """Whether the window is closed for good."""
        return self._window is not None and self._window.closed

    def show(self, snapshots: Sequence[Snapshot]) -> Any:
        """Show one snapshot of each row.

        Returns:
            ``rgb_array``: for each row an array of shape (480, 640, 3), uint8; ``mosaic``: one such array of the first
            64 rows; ``human``: None.
        """
        if self._window is not None:
            return self._window.show(snapshots)
        if self._mode == "mosaic":
            self.picture.mosaic(self._surface, snapshots)
            return self.picture.pixels(self._surface)
        frames = []
        for seen in snapshots:
            self.picture.draw(self._surface, seen)
            frames.append(self.picture.pixels(self._surface))
        return tuple(frames)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
