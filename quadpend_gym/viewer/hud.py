"""The head-up display: time, error, tilt, wind and return of a snapshot, as text."""

from typing import Any

import numpy as np

from quadpend_gym.physics.state import Disturbance
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.primitives import polygon, text_width, write
from quadpend_gym.viewer.snapshot import Snapshot

_MIN_UNIT = 0.55  # pixels; smaller pictures have no display
_PANEL_OPACITY = 190


def draw(surface: Any, snapshot: Snapshot, title: str, colour: Colour) -> None:
    """Draw the display into the top left corner of a picture."""
    width, height = surface.get_size()
    unit = min(height / 480.0, width / 440.0)  # pixels; 1 in a picture of 640 × 480 pixels
    if unit < _MIN_UNIT:
        return
    rows = {
        "time": f"{snapshot.time:.2f} s",
        "error": f"{1e3 * snapshot.error:.0f} mm",
        "tilt": f"{np.degrees(snapshot.tilt):.0f}°",
        "wind": f"{np.linalg.norm(Disturbance(snapshot.disturbance).force):.2g} N",
        "return": f"{snapshot.episode_return:.1f}",
    }
    left, y, title_size = 20.0 * unit, 20.0 * unit, round(26 * unit)
    right = left + max(134.0 * unit, text_width(title, title_size))
    bottom = y + (27.0 * bool(title) + 21.0 * len(rows)) * unit
    edge = 8.0 * unit
    corners = [(left - edge, y - edge), (right + edge, y - edge), (right + edge, bottom), (left - edge, bottom)]
    polygon(surface, np.array(corners), palette.WHITE, _PANEL_OPACITY)
    if title:
        write(surface, title, (left, y), title_size, blend(colour, palette.INK, 0.15))
        y += 27.0 * unit
    for name, value in rows.items():
        write(surface, name, (left, y), round(20 * unit), palette.GREY)
        write(surface, value, (left + 134.0 * unit, y), round(20 * unit), palette.INK, "topright")
        y += 21.0 * unit
