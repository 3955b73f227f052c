"""Anti-aliased lines, polygons, circles, arrows and text on a pygame surface, in pixels."""

from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import pygame
from pygame import gfxdraw

from quadpend_gym.core.arrays import Floats
from quadpend_gym.viewer.palette import Colour

Point: TypeAlias = Any  # two or more numbers; the first two are pixels from the left and from the top
_MAX_COORDINATE = 16000.0  # pixels; gfxdraw uses 16-bit integers


def polygon(surface: Any, points: Floats, colour: Colour, opacity: int = 255) -> None:
    """Fill a polygon with corners of shape (n, 2) or wider."""
    corners = np.clip(points[:, :2], -_MAX_COORDINATE, _MAX_COORDINATE).tolist()
    gfxdraw.filled_polygon(surface, corners, (*colour, opacity))
    gfxdraw.aapolygon(surface, corners, (*colour, opacity))


def line(surface: Any, start: Point, end: Point, colour: Colour, width: float = 1.0) -> None:
    """Draw a straight line."""
    if max(abs(start[0]), abs(start[1]), abs(end[0]), abs(end[1])) < _MAX_COORDINATE:
        pygame.draw.aaline(surface, colour, (start[0], start[1]), (end[0], end[1]), max(round(width), 1))


def circle(surface: Any, centre: Point, radius: float, colour: Colour, width: int = 0) -> None:
    """Draw a circle of this line width; width 0 fills it."""
    if max(abs(centre[0]), abs(centre[1])) < _MAX_COORDINATE:
        pygame.draw.aacircle(surface, colour, (centre[0], centre[1]), max(radius, 1.0), width)


def arrow(surface: Any, start: Point, end: Point, colour: Colour, width: float) -> None:
    """Draw a line with an arrowhead at `end`; arrows shorter than 2 pixels are omitted."""
    along = np.array([end[0] - start[0], end[1] - start[1]])
    length = float(np.hypot(*along))
    if length < 2.0:
        return
    along /= length
    head = min(3.5 * width, 0.6 * length)
    tip, across = np.asarray(end[:2], float), np.array([-along[1], along[0]])
    neck = tip - head * along
    line(surface, start, neck, colour, width)
    polygon(surface, np.array([tip, neck + 0.5 * head * across, neck - 0.5 * head * across]), colour)


def write(surface: Any, text: str, at: Point, size: int, colour: Colour, anchor: str = "topleft") -> None:
    """Write a line of text; `anchor`, an attribute of `pygame.Rect`, is the point of its rectangle placed at `at`."""
    rendered = _render(text, size, colour)
    surface.blit(rendered, rendered.get_rect(**{anchor: (round(at[0]), round(at[1]))}))


@lru_cache(2000)
def _render(text: str, size: int, colour: Colour) -> Any:
    """Return a line of text in the font that pygame ships, which looks the same on every machine."""
    pygame.font.init()  # again after other code has called pygame.quit()
    return pygame.font.Font(None, size).render(text, True, colour)
