"""Smooth lines and areas on a pygame surface, in pixels."""

from typing import Any, TypeAlias

import numpy as np
import pygame
from pygame import gfxdraw

from quadpend_gym.core.arrays import Floats
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
