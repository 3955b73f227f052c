"""What one reads off a picture in numbers: tilt, thrust, wind, time, error and return."""

from typing import Any

import numpy as np

from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.camera import View
from quadpend_gym.viewer.palette import Colour, mixed
from quadpend_gym.viewer.primitives import area, arrow, disc, line, ring
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_gym.viewer.text import TextRenderer

_MOST = 2.0  # of the weight, at the end of the thrust's bar
_STRONG = 0.5  # N, at the rim of the wind's gauge
_SMALLEST = 0.55  # of the usual size, below which a picture has no gauges


def draw(surface: Any, view: View, letters: TextRenderer, seen: Snapshot, title: str, colour: Colour) -> None:
    """Draw them into the corners, the directions as the camera sees them."""
    width, height = surface.get_size()
    unit = min(height / 480.0, width / 440.0)
    if unit < _SMALLEST:
        return
    small, large = round(20 * unit), round(26 * unit)
    margin = 12.0 * unit
    wide = max(150.0 * unit, letters.width(title, large) + 16.0 * unit)
    _box(surface, (margin, margin), (wide, (102.0 if title else 74.0) * unit))
    y = margin + 8.0 * unit
    if title:
        letters.write(surface, title, (margin + 8.0 * unit, y), large, mixed(colour, paint.INK, 0.15))
        y += 27.0 * unit
    for name, value in (
        ("time", f"{seen.time:.2f} s"),
        ("error", f"{1e3 * seen.error:.0f} mm"),
        ("return", f"{seen.episode_return:.1f}"),
    ):
        letters.write(surface, name, (margin + 8.0 * unit, y), small, paint.FAINT)
        letters.write(surface, value, (margin + 142.0 * unit, y), small, paint.INK, "topright")
        y += 21.0 * unit

    _legend(surface, letters, (width - 100.0 * unit, margin), small, unit, colour)
    radius = 36.0 * unit
    right = _heading(view)
    level = (margin + radius + 8.0 * unit, height - margin - radius - 26.0 * unit)
    _dial(surface, letters, level, radius, f"tilt {np.degrees(seen.tilt):.0f}°", small, unit)
    ring(surface, level, 0.5 * radius, mixed(paint.FAINT, paint.PAPER, 0.6))
    lean = right @ seen.state.direction[:2]
    if np.hypot(*lean) < 1e-9:  # upright, or hanging
        lean = np.array([1e-9, 0.0])
    share = min(seen.tilt / max(seen.tilt_limit, 1e-9), 1.0) / float(np.hypot(*lean))
    disc(surface, (level[0] + radius * share * lean[0], level[1] - radius * share * lean[1]), 6.0 * unit, colour)

    rose = (width - margin - radius - 8.0 * unit, level[1])
    force = seen.disturbance[:3]
    strength = float(np.linalg.norm(force))
    _dial(surface, letters, rose, radius, f"wind {strength:.2f} N", small, unit)
    blow = right @ force[:2] / _STRONG
    blow *= radius / max(float(np.hypot(*blow)), 1.0)
    if strength > 0.005:
        middle, half = np.array(rose), np.array([blow[0], -blow[1]])
        arrow(surface, middle - half, middle + half, paint.WIND, 4.0 * unit)

    bar = np.array([rose[0] - radius - 60.0 * unit, rose[1] - radius])
    _bar(surface, letters, bar, 12.0 * unit, 2.0 * radius, seen.thrust / _MOST, small, unit)


def _legend(
    surface: Any, letters: TextRenderer, at: tuple[float, float], size: int, unit: float, colour: Colour
) -> None:
    """What the scene's signs mean."""
    x, y = at
    _box(surface, at, (88.0 * unit, 74.0 * unit))
    disc(surface, (x + 16.0 * unit, y + 15.0 * unit), 5.0 * unit, colour)
    ring(surface, (x + 16.0 * unit, y + 36.0 * unit), 7.0 * unit, paint.REFERENCE, max(round(2.0 * unit), 1))
    middle = y + 57.0 * unit
    arrow(surface, (x + 6.0 * unit, middle), (x + 28.0 * unit, middle), paint.WIND, 3.0 * unit)
    for i, text in enumerate(("bob", "target", "wind")):
        letters.write(surface, text, (x + 34.0 * unit, y + (8.0 + 21.0 * i) * unit), size, paint.INK)


def _heading(view: View) -> Any:
    """What turns a horizontal vector of the world into one to the right and away, shape (2, 2)."""
    right = view.axes[0, :2]
    return np.array([right, [-right[1], right[0]]])


def _box(surface: Any, at: tuple[float, float], size: tuple[float, float]) -> None:
    (x, y), (w, h) = at, size
    area(surface, np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]), paint.PAPER, 190)


def _dial(
    surface: Any, letters: TextRenderer, at: tuple[float, float], radius: float, text: str, size: int, unit: float
) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
    area(
        surface,
        np.asarray(at) + (radius + 4.0 * unit) * np.column_stack([np.cos(turn), np.sin(turn)]),
        paint.PAPER,
        190,
    )
    ring(surface, at, radius, paint.FAINT)
    letters.write(surface, text, (at[0], at[1] + radius + 7.0 * unit), size, paint.INK, "midtop")


def _bar(
    surface: Any, letters: TextRenderer, at: Any, width: float, height: float, share: float, size: int, unit: float
) -> None:
    x, y = at
    _box(surface, (x, y), (width, height))
    top = y + height * (1.0 - min(max(share, 0.0), 1.0))
    area(surface, np.array([[x, top], [x + width, top], [x + width, y + height], [x, y + height]]), paint.SKY_BLUE)
    middle = y + 0.5 * height
    line(surface, (x - 3.0 * unit, middle), (x + width + 3.0 * unit, middle), paint.INK)
    letters.write(surface, "thrust", (x + 0.5 * width, y + height + 7.0 * unit), size, paint.INK, "midtop")
