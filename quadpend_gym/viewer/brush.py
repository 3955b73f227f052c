"""Smooth lines and areas on a pygame surface, in pixels."""

from typing import Any, TypeAlias

import numpy as np
import pygame
from pygame import gfxdraw

from quadpend_gym.arrays import Floats
from quadpend_gym.viewer.palette import Colour

Point: TypeAlias = Any  # two numbers or more, of which the first are to the right and down
_FAR = 16000.0  # pixels; gfxdraw counts in 16 bits


def area(surface: Any, points: Floats, colour: Colour, opacity: int = 255) -> None:
    """A filled polygon, corners of shape (n, 2 or more)."""
    corners = np.clip(points[:, :2], -_FAR, _FAR).tolist()
    gfxdraw.filled_polygon(surface, corners, (*colour, opacity))
    gfxdraw.aapolygon(surface, corners, (*colour, opacity))


def outline(surface: Any, points: Floats, colour: Colour, opacity: int = 255) -> None:
    """The edge of a polygon."""
    gfxdraw.aapolygon(surface, np.clip(points[:, :2], -_FAR, _FAR).tolist(), (*colour, opacity))


def line(surface: Any, start: Point, end: Point, colour: Colour, width: float = 1.0) -> None:
    """A straight line."""
    if max(abs(start[0]), abs(start[1]), abs(end[0]), abs(end[1])) < _FAR:
        pygame.draw.aaline(surface, colour, (start[0], start[1]), (end[0], end[1]), max(round(width), 1))


def disc(surface: Any, middle: Point, radius: float, colour: Colour) -> None:
    """A filled circle."""
    if max(abs(middle[0]), abs(middle[1])) < _FAR:
        pygame.draw.aacircle(surface, colour, (middle[0], middle[1]), max(radius, 1.0))


def ring(surface: Any, middle: Point, radius: float, colour: Colour, width: int = 1) -> None:
    """The edge of a circle."""
    if max(abs(middle[0]), abs(middle[1])) < _FAR:
        pygame.draw.aacircle(surface, colour, (middle[0], middle[1]), max(radius, 1.0), width)


def arrow(surface: Any, start: Point, end: Point, colour: Colour, width: float) -> None:
    """A line with a head, as long as it is."""
    along = np.array([end[0] - start[0], end[1] - start[1]])
    length = float(np.hypot(*along))
    if length < 2.0:
        return
    along /= length
    head = min(3.5 * width, 0.6 * length)
    tip, across = np.asarray(end[:2], float), np.array([-along[1], along[0]])
    neck = tip - head * along
    line(surface, start, neck, colour, width)
    area(surface, np.array([tip, neck + 0.5 * head * across, neck - 0.5 * head * across]), colour)


class Letters:
    """Text in pygame's own font, so that it looks the same everywhere."""

    def __init__(self) -> None:
        """Nothing is written yet."""
        pygame.font.init()
        self._fonts: dict[int, Any] = {}
        self._written: dict[tuple[str, int, Colour], Any] = {}

    def _picture(self, text: str, size: int, colour: Colour) -> Any:
        key = text, size, colour
        if key not in self._written:
            if len(self._written) > 2000:
                self._written.clear()
            self._written[key] = self._render(*key)
        return self._written[key]

    def _render(self, text: str, size: int, colour: Colour) -> Any:
        try:
            return self._font(size).render(text, True, colour)
        except pygame.error:  # somebody else has quit pygame since
            pygame.font.init()
            self._fonts.clear()
            return self._font(size).render(text, True, colour)

    def _font(self, size: int) -> Any:
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, size)
        return self._fonts[size]

    def width(self, text: str, size: int) -> float:
        """Of a line of text, pixels."""
        return float(self._picture(text, size, (0, 0, 0)).get_width())

    def write(self, surface: Any, text: str, at: Point, size: int, colour: Colour, anchor: str = "topleft") -> float:
        """Write a line of text, and say where it ends; `anchor` is what of its box is put there, as pygame calls it."""
        picture = self._picture(text, size, colour)
        box = picture.get_rect(**{anchor: (round(at[0]), round(at[1]))})
        surface.blit(picture, box)
        return float(box.right)
