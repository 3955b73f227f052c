"""The head-up display: tilt, thrust, wind, time, error and return of a snapshot."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.camera import View
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.primitives import Point, arrow, circle, line, polygon, rectangle, text_width, write
from quadpend_gym.viewer.snapshot import PAPER_SHAPE, Snapshot

_MAX_THRUST = 2.0  # thrust divided by the weight, at the upper end of the thrust bar
_MAX_FORCE = 0.5  # N, at the rim of the wind dial of the paper's vehicle
_MIN_UNIT = 0.55  # pixels; smaller pictures have no display
_PANEL_OPACITY = 190


class _Canvas(NamedTuple):
    """A surface of pygame and its unit of length, pixels, which is 1 in a picture of 640 × 480 pixels."""

    surface: Any
    unit: float

    def write(self, text: str, at: Point, colour: Colour = palette.INK, anchor: str = "topleft") -> None:
        """Write a line of text."""
        write(self.surface, text, at, round(20 * self.unit), colour, anchor)


def draw(surface: Any, view: View, snapshot: Snapshot, title: str, colour: Colour) -> None:
    """Draw the display into the corners of a picture; its dials show directions as the camera sees them."""
    width, height = surface.get_size()
    unit = min(height / 480.0, width / 440.0)
    if unit < _MIN_UNIT:
        return
    canvas, margin, radius = _Canvas(surface, unit), 12.0 * unit, 36.0 * unit
    _draw_numbers(canvas, margin, snapshot, title, colour)
    _draw_legend(canvas, (width - 100.0 * unit, margin), snapshot.shape.pole_name, colour)
    row = height - margin - radius - 26.0 * unit
    right = view.axes[0, :2]
    to_picture = np.array([right, [-right[1], right[0]]])  # horizontal vectors to (right, away from the camera)
    _draw_tilt(canvas, (margin + radius + 8.0 * unit, row), radius, snapshot, to_picture, colour)
    wind_dial = (width - margin - radius - 8.0 * unit, row)
    max_force = _MAX_FORCE * (PAPER_SHAPE.metres_per_newton / snapshot.shape.metres_per_newton)
    _draw_wind(canvas, wind_dial, radius, to_picture, Disturbance(snapshot.disturbance).force, max_force)
    corner = np.array([wind_dial[0] - radius - 60.0 * unit, row - radius])
    _draw_thrust(canvas, corner, 12.0 * unit, 2.0 * radius, snapshot.thrust / _MAX_THRUST)


def _draw_numbers(canvas: _Canvas, margin: float, snapshot: Snapshot, title: str, colour: Colour) -> None:
    surface, unit = canvas
    title_size = round(26 * unit)
    panel_width = max(150.0 * unit, text_width(title, title_size) + 16.0 * unit)
    panel = panel_width, (102.0 if title else 74.0) * unit
    rectangle(surface, (margin, margin), panel, palette.WHITE, _PANEL_OPACITY)
    y = margin + 8.0 * unit
    if title:
        write(surface, title, (margin + 8.0 * unit, y), title_size, blend(colour, palette.INK, 0.15))
        y += 27.0 * unit
    for name, value in (
        ("time", f"{snapshot.time:.2f} s"),
        ("error", f"{1e3 * snapshot.error:.0f} mm"),
        ("return", f"{snapshot.episode_return:.1f}"),
    ):
        canvas.write(name, (margin + 8.0 * unit, y), palette.GREY)
        canvas.write(value, (margin + 142.0 * unit, y), anchor="topright")
        y += 21.0 * unit


def _draw_legend(canvas: _Canvas, at: tuple[float, float], pole: str, colour: Colour) -> None:
    """Draw the symbols of bob, target and wind with their names."""
    (surface, unit), (x, y) = canvas, at
    rectangle(surface, at, (88.0 * unit, 74.0 * unit), palette.WHITE, _PANEL_OPACITY)
    circle(surface, (x + 16.0 * unit, y + 15.0 * unit), 5.0 * unit, colour)
    circle(surface, (x + 16.0 * unit, y + 36.0 * unit), 7.0 * unit, palette.REFERENCE, max(round(2.0 * unit), 1))
    arrow_y = y + 57.0 * unit
    arrow(surface, (x + 6.0 * unit, arrow_y), (x + 28.0 * unit, arrow_y), palette.WIND, 3.0 * unit)
    for i, name in enumerate((pole, "target", "wind")):
        canvas.write(name, (x + 34.0 * unit, y + (8.0 + 21.0 * i) * unit))


def _draw_tilt(
    canvas: _Canvas, at: tuple[float, float], radius: float, snapshot: Snapshot, to_picture: Floats, colour: Colour
) -> None:
    """Draw a dial with a dot in the direction of the pendulum's tilt; the rim is the tilt limit."""
    _draw_dial(canvas, at, radius, f"tilt {np.degrees(snapshot.tilt):.0f}°")
    circle(canvas.surface, at, 0.5 * radius, blend(palette.GREY, palette.WHITE, 0.6), width=1)
    lean = to_picture @ snapshot.state.direction[:2]
    if np.hypot(*lean) < 1e-9:  # upright or hanging: the direction is undefined
        lean = np.array([1e-9, 0.0])
    fraction = min(snapshot.tilt / max(snapshot.tilt_limit, 1e-9), 1.0) / float(np.hypot(*lean))
    dot = (at[0] + radius * fraction * lean[0], at[1] - radius * fraction * lean[1])
    circle(canvas.surface, dot, 6.0 * canvas.unit, colour)


def _draw_wind(
    canvas: _Canvas, at: tuple[float, float], radius: float, to_picture: Floats, force: Floats, max_force: float
) -> None:
    """Draw a dial with an arrow along the horizontal part of the force on the quadrotor, N, shape (3,).

    The arrow reaches the rim at the force `max_force`.
    """
    strength = float(np.linalg.norm(force))
    _draw_dial(canvas, at, radius, f"wind {strength:.{2 if max_force > 0.1 else 3}f} N")
    needle = to_picture @ force[:2] / max_force
    needle *= radius / max(float(np.hypot(*needle)), 1.0)
    if strength > 0.01 * max_force:
        centre, half = np.array(at), np.array([needle[0], -needle[1]])
        arrow(canvas.surface, centre - half, centre + half, palette.WIND, 4.0 * canvas.unit)


def _draw_thrust(canvas: _Canvas, at: Any, width: float, height: float, fraction: float) -> None:
    """Draw a bar that is filled to a fraction of its height, with a mark at one half, which is hover."""
    (surface, unit), (x, y) = canvas, at
    rectangle(surface, (x, y), (width, height), palette.WHITE, _PANEL_OPACITY)
    filled = height * min(max(fraction, 0.0), 1.0)
    rectangle(surface, (x, y + height - filled), (width, filled), palette.SKY_BLUE)
    hover = y + 0.5 * height
    line(surface, (x - 3.0 * unit, hover), (x + width + 3.0 * unit, hover), palette.INK)
    canvas.write("thrust", (x + 0.5 * width, y + height + 7.0 * unit), anchor="midtop")


def _draw_dial(canvas: _Canvas, at: tuple[float, float], radius: float, caption: str) -> None:
    """Draw a translucent disc with a rim and a caption below it."""
    surface, unit = canvas
    angle = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
    unit_circle = np.column_stack([np.cos(angle), np.sin(angle)])
    polygon(surface, np.asarray(at) + (radius + 4.0 * unit) * unit_circle, palette.WHITE, _PANEL_OPACITY)
    circle(surface, at, radius, palette.GREY, width=1)
    canvas.write(caption, (at[0], at[1] + radius + 7.0 * unit), anchor="midtop")
