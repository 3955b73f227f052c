"""The scene in perspective: ground, reference, wind, quadrotor, rod and bob.

`quadpend_gym.viewer.snapshot` has the sizes of the vehicle. The reference and the trail are drawn at the pole's centre
of mass of an upright vehicle, the pivot's offset above ζ + l r.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.camera import NEAR, View
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.primitives import arrow, circle, line, polygon
from quadpend_gym.viewer.snapshot import PAPER_SHAPE, Snapshot

BODY = 0.055  # m, radius of the body of the paper's vehicle
_GRID_RADIUS = 12  # m
_REFERENCE_TIME = 4.0  # s, part of the reference that is drawn before and after the current time
_ROTOR_OFFSET = np.array([0.0, 0.0, 0.03])  # m, from the end of an arm to its rotor, of the paper's vehicle
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros_like(_ANGLES)])
_ROTOR_SPEED = 40.0  # rad/s, slow enough for the rotation to be visible
_ONTO_GROUND = np.array([1.0, 1.0, 0.0])  # factors that project a point onto the ground


def _grid() -> tuple[Floats, list[Colour]]:
    """Return the lines of a grid with 1 m spacing around the origin, in pieces of 2 m, and their colours.

    The colours fade with the distance from the origin.
    """
    pieces = []
    for across in range(-_GRID_RADIUS, _GRID_RADIUS + 1):
        for along in range(-_GRID_RADIUS, _GRID_RADIUS, 2):
            pieces.append([[across, along, 0.0], [across, along + 2.0, 0.0]])
            pieces.append([[along, across, 0.0], [along + 2.0, across, 0.0]])
    ends = np.array(pieces, float)
    distance = np.linalg.norm(ends.mean(axis=1), axis=1) / _GRID_RADIUS
    near = distance < 1.0
    return ends[near], [blend(palette.GRID, palette.GROUND, fraction) for fraction in distance[near]]


_GRID, _GRID_COLOURS = _grid()


def draw(surface: Any, view: View, snapshot: Snapshot, bob_colour: Colour = palette.BOB) -> None:
    """Draw a snapshot over the whole of a surface; `bob_colour` is the colour of the bob and its trail."""
    width, height = surface.get_size()
    unit = height / 480.0  # pixels
    surface.fill(palette.SKY)
    surface.fill(palette.GROUND, (0, int(np.clip(view.horizon(), 0, height)), width, height))
    _draw_ground(surface, view, snapshot)
    _draw_reference(surface, view, snapshot, unit)
    _draw_trail(surface, view, snapshot, unit, bob_colour)
    _draw_vehicle(surface, view, snapshot, unit, bob_colour)


def _draw_ground(surface: Any, view: View, snapshot: Snapshot) -> None:
    """Draw the grid, the shadows and a plumb line below the quadrotor."""
    (body, hubs, _, bob, tip, _), shape = _positions(snapshot), snapshot.shape
    for i, a, b in _visible_segments(view, _GRID + np.round(body) * _ONTO_GROUND):
        line(surface, a, b, _GRID_COLOURS[i])
    for hub in hubs:
        _draw_polygon(surface, view, (hub + shape.rotor * _CIRCLE) * _ONTO_GROUND, palette.SHADOW, 60)
    for centre, radius in ((body, shape.scale * BODY), (bob, shape.bob)):
        _draw_polygon(surface, view, (centre + 1.2 * radius * _CIRCLE) * _ONTO_GROUND, palette.SHADOW, 110)
    for _, a, b in _visible_segments(view, np.array([[body, end] for end in (tip, *hubs)]) * _ONTO_GROUND):
        line(surface, a, b, palette.SHADOW)
    for _, a, b in _visible_segments(view, np.array([[body, body * _ONTO_GROUND]])):
        line(surface, a, b, palette.GREY)


def _draw_reference(surface: Any, view: View, snapshot: Snapshot, unit: float) -> None:
    """Draw the bob's reference path and its current position."""
    time = snapshot.time + np.linspace(-_REFERENCE_TIME, _REFERENCE_TIME, 81)
    path = snapshot.reference.derivatives(np.append(time, snapshot.time))[:, 0, :3]
    path[:, 2] += snapshot.reference_arm
    path += snapshot.shape.pivot
    for _, a, b in _visible_segments(view, np.stack([path[:-2], path[1:-1]], axis=1)):
        if np.hypot(a[0] - b[0], a[1] - b[1]) > 0.3:
            line(surface, a, b, palette.REFERENCE, max(1.6 * unit, 1.0))
    x, y, depth = view.project(path[-1])
    if depth > NEAR:
        radius = view.focal_length * 1.35 * snapshot.shape.bob / depth
        circle(surface, (x, y), radius, palette.REFERENCE, max(round(2.0 * unit), 1))


def _draw_trail(surface: Any, view: View, snapshot: Snapshot, unit: float, colour: Colour) -> None:
    """Draw the bob's past positions in colours that fade with age."""
    if len(snapshot.trail) < 2:
        return
    points = snapshot.trail[::-3][::-1] + snapshot.shape.pivot
    for i, a, b in _visible_segments(view, np.stack([points[:-1], points[1:]], axis=1)):
        fraction = 0.15 + 0.85 * i / (len(points) - 1)
        line(surface, a, b, blend(palette.SKY, colour, fraction), max(1.6 * unit, 1.0))


def _draw_vehicle(surface: Any, view: View, snapshot: Snapshot, unit: float, bob_colour: Colour) -> None:
    """Draw the parts of the vehicle and the force arrows, the farthest first."""
    (body, hubs, pivot, bob, tip, rotation), shape = _positions(snapshot), snapshot.shape
    parts: list[tuple[float, Callable[[], None]]] = []

    def add(position: Floats, draw_part: Callable[[], None]) -> None:
        depth = float(view.to_camera(position)[2])
        if depth > 2.0 * NEAR:
            parts.append((depth, draw_part))

    pixels = view.project(np.array([body, bob, pivot, tip, *hubs]))
    scale = view.focal_length / pixels[:, 2].clip(NEAR)  # pixels per metre
    up = rotation[:, 2]
    arm = 0.022 * shape.scale
    for i, hub in enumerate(hubs):
        add(0.5 * (body + hub), partial(line, surface, pixels[0], pixels[4 + i], palette.ARM, arm * scale[0]))
        add(hub + 0.06 * shape.scale * up, partial(_draw_rotor, surface, view, snapshot, i, unit))
    rim = body + shape.scale * BODY * (_CIRCLE @ rotation.T)
    add(body, partial(_draw_polygon, surface, view, rim, palette.BODY))
    if shape.pivot.any():
        add(0.5 * (body + pivot), partial(line, surface, pixels[0], pixels[2], palette.ARM, arm * scale[0]))
    rod = 0.5 * (pivot + tip)
    rod_scale = view.focal_length / max(float(view.to_camera(rod)[2]), NEAR)
    add(rod + 0.01 * up, partial(line, surface, pixels[2], pixels[3], palette.INK, shape.pole * rod_scale))
    add(bob, partial(_draw_ball, surface, pixels[1], shape.bob * scale[1], bob_colour))
    disturbance = Disturbance(snapshot.disturbance)
    visible = 0.02 * (PAPER_SHAPE.metres_per_newton / shape.metres_per_newton)  # N
    for position, force in ((body, disturbance.force), (bob, disturbance.bob_force)):
        if np.linalg.norm(force) > visible:
            end = view.project(position + shape.metres_per_newton * force)
            start = view.project(position)
            if min(end[2], start[2]) > NEAR:
                in_front = position - 0.2 * view.axes[2]
                add(in_front, partial(arrow, surface, start, end, palette.WIND, max(4.0 * unit, 1.5)))
    for _, draw_part in sorted(parts, key=lambda part: -part[0]):
        draw_part()


def _draw_rotor(surface: Any, view: View, snapshot: Snapshot, i: int, unit: float) -> None:
    """Draw the disc and the blades of rotor `i`."""
    places, shape = _positions(snapshot), snapshot.shape
    rotation = places.rotation
    centre = places.hubs[i] + rotation @ (shape.scale * _ROTOR_OFFSET)
    rim = view.project(centre + shape.rotor * (_CIRCLE @ rotation.T))
    if rim[:, 2].min() < NEAR:
        return
    colour = palette.FRONT if shape.front[i] else palette.ROTOR  # the rotors at the front show the heading
    polygon(surface, rim, colour, 90)
    angle = -shape.spins[i] * _ROTOR_SPEED * snapshot.time
    blade = 0.95 * shape.rotor * (rotation @ np.array([np.cos(angle), np.sin(angle), 0.0]))
    a, b = view.project(np.array([centre - blade, centre + blade]))
    line(surface, a, b, blend(colour, palette.INK, 0.5), 2.0 * unit)


def _draw_ball(surface: Any, at: Floats, radius: float, colour: Colour) -> None:
    """Draw the bob with a dark rim and a highlight."""
    circle(surface, at, radius, blend(colour, palette.INK, 0.35))
    circle(surface, at, 0.9 * radius, colour)
    circle(surface, at[:2] - 0.3 * radius, 0.3 * radius, blend(colour, palette.WHITE, 0.55))


def _draw_polygon(surface: Any, view: View, points: Floats, colour: Colour, opacity: int = 255) -> None:
    """Draw a filled polygon in space, unless a corner is behind the near plane."""
    pixels = view.project(points)
    if pixels[:, 2].min() > NEAR:
        polygon(surface, pixels, colour, opacity)


def _visible_segments(view: View, ends: Floats) -> Iterator[tuple[int, list[float], list[float]]]:
    """Yield index and both ends, in pixels, of each line segment of `ends`, shape (n, 2, 3), before the near plane."""
    pixels = view.project(ends)
    for i in np.flatnonzero(pixels[..., 2].min(axis=1) > NEAR).tolist():
        yield i, *pixels[i].tolist()


class _Positions(NamedTuple):
    """Positions in the world frame, m, each of shape (3,) but `hubs`, shape (4, 3), and the body's rotation matrix."""

    body: Floats
    hubs: Floats
    pivot: Floats
    bob: Floats
    tip: Floats
    rotation: Floats


def _positions(snapshot: Snapshot) -> _Positions:
    """Return the positions of body, hubs, pivot, bob (the pole's centre of mass) and tip of the pole."""
    body, shape = snapshot.state.position, snapshot.shape
    rotation = Rotation.from_euler("xyz", snapshot.state.euler).as_matrix()
    pivot, pole = body + rotation @ shape.pivot, snapshot.rod_length * snapshot.state.direction
    return _Positions(
        body, body + shape.hubs @ rotation.T, pivot, pivot + pole, pivot + shape.pole_ratio * pole, rotation
    )
