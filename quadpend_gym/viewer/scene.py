"""The scene in perspective: ground, reference, wind, quadrotor, rod and bob.

Sizes that the model does not have (arms, rotors, the bob's radius) are for the eye only.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pygame
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.camera import NEAR, View
from quadpend_gym.viewer.palette import Colour, mixed
from quadpend_gym.viewer.primitives import area, arrow, disc, line, outline, ring
from quadpend_gym.viewer.snapshot import Snapshot

ARM, ROTOR, BODY, BOB = 0.2, 0.11, 0.055, 0.045  # m: arm's length, radii
METRES_PER_NEWTON = 0.7  # of an arrow of force
_REACH = 12  # m, of the grid
_AHEAD = 4.0  # s of the reference before and after now
_HUBS = ARM * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_LIFT = np.array([0.0, 0.0, 0.03])  # of a rotor above its arm
_TURN = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
_ROUND = np.column_stack([np.cos(_TURN), np.sin(_TURN), np.zeros_like(_TURN)])


def _grid() -> tuple[Floats, list[Colour]]:
    """Lines of one metre's mesh around the origin, in pieces of 2 m, and their colours, fainter far away."""
    pieces = []
    for across in range(-_REACH, _REACH + 1):
        for along in range(-_REACH, _REACH, 2):
            pieces.append([[across, along, 0.0], [across, along + 2.0, 0.0]])
            pieces.append([[along, across, 0.0], [along + 2.0, across, 0.0]])
    ends = np.array(pieces, float)
    distance = np.linalg.norm(ends.mean(axis=1), axis=1) / _REACH
    near = distance < 1.0
    return ends[near], [mixed(paint.GRID, paint.GROUND_FAR, share) for share in distance[near]]


_GRID, _GRID_COLOURS = _grid()
_STREAKS = np.random.default_rng(5).random((60, 3))  # where they are, in shares of their box
_BOX = np.array([5.0, 5.0, 2.4])  # m, around where one looks


class Backdrop:
    """Sky and ground for a horizon, remembered."""

    def __init__(self) -> None:
        """Nothing is drawn yet."""
        self._drawn: dict[tuple[int, int, int], Any] = {}

    def draw(self, surface: Any, view: View) -> None:
        """Fill the picture."""
        width, height = surface.get_size()
        level = int(np.clip(view.horizon(), -1, height))
        key = width, height, level
        if key not in self._drawn:
            if len(self._drawn) > 64:
                self._drawn.clear()
            column = pygame.Surface((1, height))
            for y in range(height):
                if y < level:
                    colour = mixed(paint.SKY, paint.HORIZON, (y / level) ** 1.5)
                else:
                    colour = mixed(paint.GROUND_FAR, paint.GROUND_NEAR, min((y - level) / (0.6 * height), 1.0))
                column.set_at((0, y), colour)
            self._drawn[key] = pygame.transform.scale(column, (width, height))
        surface.blit(self._drawn[key], (0, 0))


def draw(surface: Any, view: View, backdrop: Backdrop, seen: Snapshot, colour: Colour = paint.BOB) -> None:
    """Draw a snapshot; `colour` is that of bob and trail."""
    size = surface.get_height() / 480.0
    backdrop.draw(surface, view)
    _ground(surface, view, seen)
    _streaks(surface, view, seen, size)
    _reference(surface, view, seen, size)
    _trail(surface, view, seen, size, colour)
    _vehicle(surface, view, seen, size, colour)


def _ground(surface: Any, view: View, seen: Snapshot) -> None:
    cell = np.array([np.round(seen.focus[0]), np.round(seen.focus[1]), 0.0])
    for i, a, b in _pieces(view, _GRID + cell):
        line(surface, a, b, _GRID_COLOURS[i])
    body, hubs, bob, _ = _points(seen)
    flat = np.array([1.0, 1.0, 0.0])
    for hub in hubs:
        _area(surface, view, (hub + ROTOR * _ROUND) * flat, paint.SHADOW, 60)
    for shadow, radius in ((body, BODY), (bob, BOB)):
        _area(surface, view, (shadow + 1.2 * radius * _ROUND) * flat, paint.SHADOW, 110)
    for _, a, b in _pieces(view, np.array([[body, end] for end in (bob, *hubs)]) * flat):
        line(surface, a, b, paint.SHADOW)
    plumb = np.linspace(body, body * flat, 2 * min(max(int(body[2] / 0.12), 1), 100))
    for _, a, b in _pieces(view, np.stack([plumb[:-1:2], plumb[1::2]], axis=1)):  # every other piece: dashes
        line(surface, a, b, paint.FAINT)


def _streaks(surface: Any, view: View, seen: Snapshot, size: float) -> None:
    force = seen.disturbance[:3]
    length = METRES_PER_NEWTON * force
    if np.linalg.norm(length) < 0.01:
        return
    low = seen.focus - 0.5 * _BOX
    start = low + np.mod(_STREAKS * _BOX + seen.drift - low, _BOX)
    ends, visible = view.segments(np.stack([start, start + length], axis=1))
    edge = np.abs((start - seen.focus) / (0.5 * _BOX)).max(axis=1)
    shown = visible & (start[:, 2] > 0.05) & (ends[..., 2].min(axis=1) > 0.6)
    for i in np.flatnonzero(shown):
        a, b = ends[i]
        line(surface, a, b, mixed(paint.WIND, paint.HORIZON, 0.45 + 0.5 * edge[i] ** 3), max(size * 3.2 / a[2], 1.0))


def _reference(surface: Any, view: View, seen: Snapshot, size: float) -> None:
    time = seen.time + np.linspace(-_AHEAD, _AHEAD, 81)
    path = seen.reference.derivatives(np.append(time, seen.time))[:, 0, :3]
    path[:, 2] += seen.rod_length  # where the bob belongs
    for _, a, b in _pieces(view, np.stack([path[:-2], path[1:-1]], axis=1)):
        if np.hypot(a[0] - b[0], a[1] - b[1]) > 0.3:
            line(surface, a, b, paint.REFERENCE, max(1.6 * size, 1.0))
    x, y, depth = view.project(path[-1])
    if depth < NEAR:
        return
    ring(surface, (x, y), view.focal * 1.35 * BOB / depth, paint.REFERENCE, max(round(2.0 * size), 1))
    away = np.array([x, y]) - view.middle
    share = float((np.abs(away) / view.middle).max())
    if share > 1.0:  # it is out of the picture: point to it
        tip = view.middle + 0.9 * away / share
        arrow(surface, tip - 30.0 * size * away / np.hypot(*away), tip, paint.REFERENCE, 3.0 * size)


def _trail(surface: Any, view: View, seen: Snapshot, size: float, colour: Colour) -> None:
    if len(seen.trail) < 2:
        return
    points = seen.trail[::-3][::-1]
    for i, a, b in _pieces(view, np.stack([points[:-1], points[1:]], axis=1)):
        fresh = 0.15 + 0.85 * i / (len(points) - 1)
        line(surface, a, b, mixed(paint.HORIZON, colour, fresh), max(1.6 * size, 1.0))


def _vehicle(surface: Any, view: View, seen: Snapshot, size: float, colour: Colour) -> None:
    """The parts, the farthest first."""
    body, hubs, bob, turn = _points(seen)
    parts: list[tuple[float, Any]] = []

    def add(where: Floats, paintbrush: Any) -> None:
        depth = float(view.seen(where)[2])
        if depth > 2.0 * NEAR:
            parts.append((depth, paintbrush))

    pixels = view.project(np.array([body, bob, *hubs]))
    px = view.focal / pixels[:, 2].clip(NEAR)
    for i, hub in enumerate(hubs):
        add(0.5 * (body + hub), lambda i=i: line(surface, pixels[0], pixels[2 + i], paint.ARM, 0.022 * px[0]))
        add(hub + 0.06 * turn[:, 2], lambda i=i, hub=hub: _rotor(surface, view, hub, turn, i, seen.spin, size))
    add(body, lambda: _area(surface, view, body + BODY * (_ROUND @ turn.T), paint.BODY))
    middle_px = view.focal / max(float(view.seen(0.5 * (body + bob))[2]), NEAR)
    add(
        0.5 * (body + bob) + 0.01 * turn[:, 2],
        lambda: line(surface, pixels[0], pixels[1], paint.INK, 0.016 * middle_px),
    )
    add(bob, lambda: _ball(surface, pixels[1], BOB * px[1], colour))
    for where, force in ((body, seen.disturbance[:3]), (bob, seen.disturbance[3:6])):
        if np.linalg.norm(force) > 0.02:
            tip = view.project(where + METRES_PER_NEWTON * force)
            start = view.project(where)
            if min(tip[2], start[2]) > NEAR:
                add(
                    where - 0.2 * view.axes[2],
                    lambda a=start, b=tip: arrow(surface, a, b, paint.WIND, max(4.0 * size, 1.5)),
                )
    for _, paintbrush in sorted(parts, key=lambda part: -part[0]):
        paintbrush()


def _pieces(view: View, ends: Floats) -> Iterator[tuple[int, list[float], list[float]]]:
    """Number and ends, in pixels, of those of the line segments, shape (n, 2, 3), that are to be seen."""
    pixels, visible = view.segments(ends)
    flat = pixels.tolist()
    for i in np.flatnonzero(visible).tolist():
        yield i, *flat[i]


def _points(seen: Snapshot) -> tuple[Floats, Floats, Floats, Floats]:
    """Centre, hubs and bob, m, and the body's rotation, shape (3, 3)."""
    body = seen.state.position
    turn = Rotation.from_euler("xyz", seen.state.euler).as_matrix()
    return body, body + _HUBS @ turn.T, seen.bob, turn


def _rotor(surface: Any, view: View, hub: Floats, turn: Floats, i: int, angle: float, size: float) -> None:
    middle = hub + turn @ _LIFT
    rim = view.project(middle + ROTOR * (_ROUND @ turn.T))
    if rim[:, 2].min() < NEAR:
        return
    colour = paint.FRONT if i == 0 else paint.ROTOR  # the front rotor, on the body's x axis, shows the heading
    area(surface, rim, colour, 90)
    outline(surface, rim, colour)
    angle = angle if i % 2 else -angle
    blade = 0.95 * ROTOR * (turn @ np.array([np.cos(angle), np.sin(angle), 0.0]))
    a, b = view.project(np.array([middle - blade, middle + blade]))
    line(surface, a, b, mixed(colour, paint.INK, 0.5), 2.0 * size)


def _ball(surface: Any, at: Floats, radius: float, colour: Colour) -> None:
    disc(surface, at, radius, mixed(colour, paint.INK, 0.35))
    disc(surface, at, 0.9 * radius, colour)
    disc(surface, at[:2] - 0.3 * radius, 0.3 * radius, mixed(colour, paint.PAPER, 0.55))


def _area(surface: Any, view: View, points: Floats, colour: Colour, opacity: int = 255) -> None:
    pixels = view.project(points)
    if pixels[:, 2].min() > NEAR:
        area(surface, pixels, colour, opacity)
