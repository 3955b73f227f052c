"""The drawing of frames and symbols, `docs/frames.svg`: ``python -m quadpend_baselines.paper.drawing docs/frames.svg``.

Left, the bodies: world frame, quadrotor at ζ, bob at ζ + l r, angles α and β, forces. Right, the attitude: R takes body
vectors to the world by roll φ, then pitch θ, then yaw ψ. The picture is a parallel projection, made here.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats

# The palette of Okabe and Ito, which the colour-blind can tell apart
_BLACK, _GREY, _BLUE, _ORANGE, _GREEN, _PURPLE = "#000000", "#8a8a8a", "#0072b2", "#d55e00", "#009e73", "#aa4499"
_X, _Y, _Z = np.eye(3)


def _rotation(axis: int, angle: float) -> Floats:
    """Right-handed rotation about x, y or z, shape (3, 3)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[first, first] = out[second, second] = np.cos(angle)
    out[second, first], out[first, second] = np.sin(angle), -np.sin(angle)
    return out


@dataclass(frozen=True)
class _Sheet:
    """A matplotlib axes seen from a direction; draws in world coordinates."""

    axes: Any
    azimuth: float  # rad, of the eye
    elevation: float  # rad

    def flat(self, points: Floats) -> Floats:
        """Parallel projection of (..., 3) points, shape (..., 2)."""
        ca, sa = np.cos(self.azimuth), np.sin(self.azimuth)
        ce, se = np.cos(self.elevation), np.sin(self.elevation)
        return np.asarray(points @ np.array([[-sa, ca, 0.0], [-ca * se, -sa * se, ce]]).T)

    def text(self, point: Floats, label: str, shift: tuple[float, float], colour: str = _BLACK) -> None:
        """A label, shifted by so many points from where it belongs."""
        self.axes.annotate(
            label, self.flat(point), shift, textcoords="offset points", color=colour, ha="center", va="center", zorder=9
        )

    def line(self, points: Floats, colour: str = _GREY, width: float = 1.0, style: str = "-", order: int = 2) -> None:
        """A line through (n, 3) points."""
        self.axes.plot(*self.flat(points).T, color=colour, lw=width, ls=style, zorder=order, solid_capstyle="round")

    def arrow(self, start: Floats, vector: Floats, colour: str = _BLACK, width: float = 1.4, style: str = "-") -> None:
        """An arrow from a point."""
        drawn = {"arrowstyle": "-|>", "color": colour, "lw": width, "ls": style, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", self.flat(start + vector), self.flat(start), arrowprops=drawn, zorder=5)
        self.axes.update_datalim(self.flat(np.array([start, start + vector])))

    def arc(self, centre: Floats, first: Floats, second: Floats, radius: float, colour: str) -> Floats:
        """An arc around `centre` from one direction to another, with an arrowhead; returns its middle."""
        e1 = first / np.linalg.norm(first)
        e2 = second - (second @ e1) * e1
        whole = np.arctan2(np.linalg.norm(e2), second @ e1)
        angles = np.linspace(0.0, whole, 40)[:, np.newaxis]
        points = centre + radius * (np.cos(angles) * e1 + np.sin(angles) * e2 / np.linalg.norm(e2))
        self.line(points[:-3], colour, 1.4, order=4)
        self.arrow(points[-5], points[-1] - points[-5], colour)
        return np.asarray(points[20])

    def disc(self, centre: Floats, first: Floats, second: Floats, radius: float, colour: str) -> None:
        """A filled circle in the plane of two perpendicular unit vectors."""
        angles = np.linspace(0.0, 2.0 * np.pi, 60)[:, np.newaxis]
        rim = self.flat(centre + radius * (np.cos(angles) * first + np.sin(angles) * second))
        self.axes.fill(*rim.T, facecolor=colour, alpha=0.25, edgecolor=colour, lw=1.2, zorder=3)


def _bodies(sheet: _Sheet, body: Floats) -> None:
    """World frame, quadrotor, rod, bob, angles and forces; `body` has the body's axes as columns."""
    position, length = np.array([-0.1, 1.9, 0.8]), 1.9
    alpha, beta = np.radians([34.0, 68.0])
    level = np.array([np.cos(beta), np.sin(beta), 0.0])
    r = np.sin(alpha) * level + np.cos(alpha) * _Z
    bob = position + length * r
    for axis, name in zip((_X, _Y, _Z), "xyz", strict=True):
        sheet.arrow(np.zeros(3), 0.75 * axis)
        sheet.text(0.75 * axis, f"${name}$", (-9, -4) if name == "x" else (9, 0))
    sheet.text(np.zeros(3), "world frame", (4, -26))
    sheet.arrow(np.zeros(3), position, _BLACK, 1.2, "--")
    sheet.text(0.5 * position, r"$\mathbf{\zeta}$", (-2, 11))

    sheet.line(np.array([position, position + 1.3 * _Z]), style=":")
    sheet.line(np.array([position, position + 1.0 * _X]), style=":")
    sheet.line(np.array([position, position + length * np.sin(alpha) * level, bob]), style=":")
    sheet.text(sheet.arc(position, _Z, r, 1.05, _PURPLE), r"$\alpha$", (-1, 10), _PURPLE)
    sheet.text(sheet.arc(position, _X, level, 0.8, _PURPLE), r"$\beta$", (-4, -11), _PURPLE)
    sheet.text(position + 1.0 * _X, r"$\parallel x$", (-4, -9), _GREY)

    for across in (body[:, 0], body[:, 1]):
        sheet.line(np.array([position - 0.3 * across, position + 0.3 * across]), _BLUE, 3.0, order=4)
        for side in (-0.3, 0.3):
            sheet.disc(position + side * across, body[:, 0], body[:, 1], 0.17, _BLUE)
    sheet.text(position, "quadrotor, $M$", (-72, 30), _BLUE)
    sheet.line(np.array([position, bob]), _BLACK, 2.6, order=6)
    sheet.arrow(position, 0.72 * length * r, _BLACK, 2.6)
    sheet.text(position + 0.6 * length * r, r"$l\,\mathbf{r}$", (11, -8))
    sheet.axes.plot(*sheet.flat(bob), "o", ms=15, color=_BLACK, zorder=7)
    sheet.text(bob, r"bob, $m_c$, at $\mathbf{p}=\mathbf{\zeta}+l\,\mathbf{r}$", (-12, 20))

    sheet.arrow(position, 0.95 * body[:, 2], _GREEN, 2.2)
    sheet.text(position + 0.95 * body[:, 2], r"$u\,R\,\mathbf{e}_3$", (-8, 9), _GREEN)
    for point, name, shift in ((position, "Q", (12, 2)), (bob, "B", (12, 2))):
        force = np.array([-0.45, 0.3, 0.05])
        sheet.arrow(point, force, _ORANGE, 2.2)
        sheet.text(point + force, rf"$\mathbf{{d}}_{name}$", shift, _ORANGE)
    for point, name, shift in ((position, r"$Mg$", (-3, -8)), (bob, r"$m_c g$", (16, 4))):
        sheet.arrow(point, -0.5 * _Z, _GREY, 1.6)
        sheet.text(point - 0.5 * _Z, name, shift, _GREY)


def _attitude(sheet: _Sheet, roll: float, pitch: float, yaw: float) -> None:
    """How φ, θ and ψ take the world's axes to the body's."""
    heading = _rotation(2, yaw)
    pitched = heading @ _rotation(1, pitch)
    body = pitched @ _rotation(0, roll)
    centre = np.zeros(3)
    for axis, name, shift in ((_X, "x", (-8, -5)), (_Y, "y", (9, 2)), (_Z, "z", (-2, 9))):
        sheet.arrow(centre, axis, _GREY, 1.2)
        sheet.text(axis, f"${name}$", shift, _GREY)
    for column in (0, 1):
        sheet.line(np.array([centre, heading[:, column]]), _GREY, style=":")
    sheet.line(np.array([centre, pitched[:, 2]]), _GREY, style=":")
    for column, colour, name, shift in (
        (0, _BLUE, r"$x_B$", (-10, -6)),
        (1, _BLUE, r"$y_B$", (12, 4)),
        (2, _GREEN, r"$R\,\mathbf{e}_3$", (14, 6)),
    ):
        sheet.arrow(centre, body[:, column], colour, 2.2)
        sheet.text(body[:, column], name, shift, colour)
    sheet.text(sheet.arc(centre, _X, heading[:, 0], 0.72, _PURPLE), r"$\psi$", (0, -10), _PURPLE)
    sheet.text(sheet.arc(centre, heading[:, 0], body[:, 0], 0.86, _PURPLE), r"$\theta$", (-8, -4), _PURPLE)
    sheet.text(sheet.arc(centre, heading[:, 1], body[:, 1], 0.78, _PURPLE), r"$\phi$", (9, 2), _PURPLE)
    sheet.text(centre, r"$R=R_z(\psi)\,R_y(\theta)\,R_x(\phi)$", (0, -120))


def draw(path: Path) -> None:
    """Write the drawing; the suffix, ``.svg`` or ``.png``, chooses the format."""
    import matplotlib
    from matplotlib.figure import Figure

    roll, pitch, yaw = np.radians([24.0, 22.0, 32.0])
    body = _rotation(2, yaw) @ _rotation(1, pitch) @ _rotation(0, roll)
    with matplotlib.rc_context({"font.size": 12, "mathtext.fontset": "cm", "svg.hashsalt": "frames"}):
        figure = Figure(figsize=(9.0, 4.3), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
        for axes in (left, right):
            axes.set_aspect("equal")
            axes.axis("off")
            axes.margins(0.06, 0.1)
        _bodies(_Sheet(left, np.radians(38.0), np.radians(20.0)), body)
        _attitude(_Sheet(right, np.radians(38.0), np.radians(24.0)), roll, pitch, yaw)
        for axes in (left, right):
            axes.autoscale_view()
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=160, metadata=metadata)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
