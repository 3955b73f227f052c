"""The drawing of frames and symbols, `docs/frames.svg`.

Run ``python -m docs.tools.frames docs/frames.svg`` to write it. The left part shows the bodies: world
frame, quadrotor at ζ, bob at ζ + l r, angles α and β, and forces. The right part shows the attitude: R rotates body
vectors to the world frame, about x by roll φ, then about y by pitch θ, then about z by yaw ψ. Both parts are parallel
projections.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats

# Colours for colour-blind readers, most of them from the palette of Okabe and Ito
_BLACK, _GREY, _BLUE, _ORANGE, _GREEN, _PURPLE = "#000000", "#8a8a8a", "#0072b2", "#d55e00", "#009e73", "#aa4499"
_X, _Y, _Z = np.eye(3)


def _rotation(axis: int, angle: float) -> Floats:
    """Return the right-handed rotation by `angle` (rad) about x, y or z (`axis` 0, 1, 2), shape (3, 3)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[first, first] = out[second, second] = np.cos(angle)
    out[second, first], out[first, second] = np.sin(angle), -np.sin(angle)
    return out


@dataclass(frozen=True)
class _Projection:
    """Draws world coordinates on matplotlib axes by a parallel projection.

    Attributes:
        axes: The matplotlib axes.
        azimuth: Azimuth of the viewing direction, rad.
        elevation: Elevation of the viewing direction, rad.
    """

    axes: Any
    azimuth: float
    elevation: float

    def project(self, points: Floats) -> Floats:
        """Return the projection of points, shape (..., 3), to the plane, shape (..., 2)."""
        ca, sa = np.cos(self.azimuth), np.sin(self.azimuth)
        ce, se = np.cos(self.elevation), np.sin(self.elevation)
        return np.asarray(points @ np.array([[-sa, ca, 0.0], [-ca * se, -sa * se, ce]]).T)

    def text(self, point: Floats, label: str, shift: tuple[float, float], colour: str = _BLACK) -> None:
        """Draw a label, offset from its point by `shift` (typographic points)."""
        self.axes.annotate(
            label,
            self.project(point),
            shift,
            textcoords="offset points",
            color=colour,
            ha="center",
            va="center",
            zorder=9,
        )

    def line(self, points: Floats, colour: str = _GREY, width: float = 1.0, style: str = "-", order: int = 2) -> None:
        """Draw a line through points, shape (n, 3)."""
        self.axes.plot(*self.project(points).T, color=colour, lw=width, ls=style, zorder=order, solid_capstyle="round")

    def arrow(self, start: Floats, vector: Floats, colour: str = _BLACK, width: float = 1.4, style: str = "-") -> None:
        """Draw an arrow from a point along a vector."""
        drawn = {"arrowstyle": "-|>", "color": colour, "lw": width, "ls": style, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", self.project(start + vector), self.project(start), arrowprops=drawn, zorder=5)
        self.axes.update_datalim(self.project(np.array([start, start + vector])))

    def arc(self, centre: Floats, first: Floats, second: Floats, radius: float, colour: str) -> Floats:
        """Draw an arc with an arrowhead around `centre` from one direction to another; return its middle point."""
        e1 = first / np.linalg.norm(first)
        e2 = second - (second @ e1) * e1
        whole = np.arctan2(np.linalg.norm(e2), second @ e1)
        angles = np.linspace(0.0, whole, 40)[:, np.newaxis]
        points = centre + radius * (np.cos(angles) * e1 + np.sin(angles) * e2 / np.linalg.norm(e2))
        self.line(points[:-3], colour, 1.4, order=4)
        self.arrow(points[-5], points[-1] - points[-5], colour)
        return np.asarray(points[20])

    def disc(self, centre: Floats, first: Floats, second: Floats, radius: float, colour: str) -> None:
        """Draw a filled circle in the plane of two perpendicular unit vectors."""
        angles = np.linspace(0.0, 2.0 * np.pi, 60)[:, np.newaxis]
        rim = self.project(centre + radius * (np.cos(angles) * first + np.sin(angles) * second))
        self.axes.fill(*rim.T, facecolor=colour, alpha=0.25, edgecolor=colour, lw=1.2, zorder=3)


def _bodies(view: _Projection, body: Floats) -> None:
    """Draw world frame, quadrotor, rod, bob, angles and forces; the columns of `body` are the axes of the body."""
    position, length = np.array([-0.1, 1.9, 0.8]), 1.9
    alpha, beta = np.radians([34.0, 68.0])
    level = np.array([np.cos(beta), np.sin(beta), 0.0])
    r = np.sin(alpha) * level + np.cos(alpha) * _Z
    bob = position + length * r
    for axis, name in zip((_X, _Y, _Z), "xyz", strict=True):
        view.arrow(np.zeros(3), 0.75 * axis)
        view.text(0.75 * axis, f"${name}$", (-9, -4) if name == "x" else (9, 0))
    view.text(np.zeros(3), "world frame", (6, -30))
    view.arrow(np.zeros(3), position, _BLACK, 1.2, "--")
    view.text(0.5 * position, r"$\mathbf{\zeta}$", (-2, 11))

    view.line(np.array([position, position + 1.3 * _Z]), style=":")
    view.line(np.array([position, position + 1.0 * _X]), style=":")
    view.line(np.array([position, position + length * np.sin(alpha) * level, bob]), style=":")
    view.text(view.arc(position, _Z, r, 1.05, _PURPLE), r"$\alpha$", (-1, 10), _PURPLE)
    view.text(view.arc(position, _X, level, 0.8, _PURPLE), r"$\beta$", (-4, -11), _PURPLE)
    view.text(position + 1.0 * _X, r"$\parallel x$", (-4, -9), _GREY)

    for across in (body[:, 0], body[:, 1]):
        view.line(np.array([position - 0.3 * across, position + 0.3 * across]), _BLUE, 3.0, order=4)
        for side in (-0.3, 0.3):
            view.disc(position + side * across, body[:, 0], body[:, 1], 0.17, _BLUE)
    view.text(position, "quadrotor, $M$", (-70, 34), _BLUE)
    view.line(np.array([position, bob]), _BLACK, 2.6, order=6)
    view.arrow(position, 0.72 * length * r, _BLACK, 2.6)
    view.text(position + 0.6 * length * r, r"rod $l\,\mathbf{r}$", (25, -18))
    view.axes.plot(*view.project(bob), "o", ms=15, color=_BLACK, zorder=7)
    view.text(bob, r"bob, $m_c$, at $\mathbf{p}=\mathbf{\zeta}+l\,\mathbf{r}$", (-56, 22))

    view.arrow(position, 0.95 * body[:, 2], _GREEN, 2.2)
    view.text(position + 0.95 * body[:, 2], r"thrust $u\,R\,\mathbf{e}_3$", (-28, 9), _GREEN)
    for point, name, shift in ((position, "Q", (16, 10)), (bob, "B", (10, 11))):
        force = np.array([-0.45, 0.3, 0.05])
        view.arrow(point, force, _ORANGE, 2.2)
        view.text(point + force, rf"wind $\mathbf{{d}}_{name}$", shift, _ORANGE)
    for point, name, shift in ((position, r"$Mg$", (-3, -8)), (bob, r"$m_c g$", (19, 5))):
        view.arrow(point, -0.5 * _Z, _GREY, 1.6)
        view.text(point - 0.5 * _Z, name, shift, _GREY)


def _attitude(view: _Projection, roll: float, pitch: float, yaw: float) -> None:
    """Draw the rotation of the world axes to the body axes by φ, θ and ψ (rad)."""
    heading = _rotation(2, yaw)
    pitched = heading @ _rotation(1, pitch)
    body = pitched @ _rotation(0, roll)
    centre = np.zeros(3)
    for axis, name, shift in ((_X, "x", (-8, -5)), (_Y, "y", (9, 2)), (_Z, "z", (-2, 9))):
        view.arrow(centre, axis, _GREY, 1.2)
        view.text(axis, f"${name}$", shift, _GREY)
    for column in (0, 1):
        view.line(np.array([centre, heading[:, column]]), _GREY, style=":")
    view.line(np.array([centre, pitched[:, 2]]), _GREY, style=":")
    for column, colour, name, shift in (
        (0, _BLUE, r"$x_B$", (-10, -6)),
        (1, _BLUE, r"$y_B$", (12, 4)),
        (2, _GREEN, r"$R\,\mathbf{e}_3$", (14, 6)),
    ):
        view.arrow(centre, body[:, column], colour, 2.2)
        view.text(body[:, column], name, shift, colour)
    view.text(view.arc(centre, _X, heading[:, 0], 0.72, _PURPLE), r"yaw $\psi$", (-14, -12), _PURPLE)
    view.text(view.arc(centre, heading[:, 0], body[:, 0], 0.86, _PURPLE), r"pitch $\theta$", (-31, -6), _PURPLE)
    view.text(view.arc(centre, heading[:, 1], body[:, 1], 0.78, _PURPLE), r"roll $\phi$", (20, 2), _PURPLE)
    view.text(centre, r"$R=R_z(\psi)\,R_y(\theta)\,R_x(\phi)$", (0, -108))
    view.text(centre, "body frame", (0, -124), _BLUE)


def draw(path: Path) -> None:
    """Write the drawing to `path`; its suffix, ``.svg`` or ``.png``, selects the format."""
    import matplotlib
    from matplotlib.figure import Figure

    roll, pitch, yaw = np.radians([24.0, 22.0, 32.0])
    body = _rotation(2, yaw) @ _rotation(1, pitch) @ _rotation(0, roll)
    with matplotlib.rc_context({"font.size": 13, "mathtext.fontset": "cm", "svg.hashsalt": "frames"}):
        figure = Figure(figsize=(7.4, 4.1), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
        for axes in (left, right):
            axes.set_aspect("equal")
            axes.axis("off")
            axes.margins(0.06, 0.1)
        _bodies(_Projection(left, np.radians(38.0), np.radians(20.0)), body)
        _attitude(_Projection(right, np.radians(38.0), np.radians(24.0)), roll, pitch, yaw)
        for axes in (left, right):
            axes.autoscale_view()
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=160, metadata=metadata)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
