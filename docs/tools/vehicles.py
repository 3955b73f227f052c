"""Draw the picture of `docs/vehicles.md` and write its tables: ``python -m docs.tools.vehicles``."""

import math
from pathlib import Path

from experiments.pages import fill
from quadpend_gym.vehicles import POLES, VEHICLES, Vehicle

DOCS = Path(__file__).parents[1]
PICTURE, PAGE = DOCS / "vehicles.svg", DOCS / "vehicles.md"
INK, GREY, FRONT, POLE, AXIS = "#1f2329", "#8a8f98", "#c98a00", "#b8420f", "#2b5fb8"
RADIUS = 34.0  # pixels, of a rotor


def line(
    start: tuple[float, float], end: tuple[float, float], colour: str = INK, width: float = 1.5, more: str = ""
) -> str:
    """Return a straight line."""
    (a, b), (c, d) = start, end
    return (
        f'<line x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}" stroke="{colour}" stroke-width="{width}" {more}/>'
    )


def text(at: tuple[float, float], words: str, colour: str = INK, anchor: str = "middle", size: int = 14) -> str:
    """Return a line of text."""
    x, y = at
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}" font-size="{size}">{words}</text>'


def arrow(start: tuple[float, float], end: tuple[float, float], colour: str, width: float = 2.0) -> str:
    """Return a line with an arrowhead."""
    return line(start, end, colour, width, f'marker-end="url(#head{colour[1:]})"')


def disc(at: tuple[float, float], radius: float, colour: str, opacity: float = 1.0) -> str:
    """Return a filled circle with an edge."""
    return (
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{colour}" fill-opacity="{opacity:g}"'
        f' stroke="{colour}"/>'
    )


def turn(centre: tuple[float, float], sign: int, colour: str) -> str:
    """Return an arrow along a circle: counter-clockwise for the sign +1."""
    x, y = centre
    r, begin, end = 0.62 * RADIUS, math.radians(200), math.radians(340)
    a, b = (begin, end) if sign < 0 else (end, begin)
    points = [f"{x + r * math.cos(angle):.1f} {y + r * math.sin(angle):.1f}" for angle in (a, b)]
    sweep = 1 if sign < 0 else 0
    return (
        f'<path d="M{points[0]} A{r:.1f} {r:.1f} 0 0 {sweep} {points[1]}" fill="none" stroke="{colour}"'
        f' stroke-width="1.8" marker-end="url(#head{colour[1:]})"/>'
    )


def from_above(vehicle: Vehicle, middle: tuple[float, float], reach: float, title: str) -> list[str]:
    """Return a vehicle seen from above: x, forward, points up and y to the left. `reach` is in pixels.

    Each rotor has the arrow of its sense of rotation and, below its number, its spin: the sign of its yaw torque.
    """
    assert vehicle.rotors
    positions, spins = vehicle.rotors.positions, vehicle.rotors.spins
    scale = reach / max(math.hypot(*position[:2]) for position in positions)
    x0, y0 = middle
    parts = [text((x0, 24), title, size=15)]
    for i, ((x, y, *_), spin) in enumerate(zip(positions, spins, strict=True), 1):
        at = (x0 - scale * y, y0 - scale * x)
        colour = FRONT if x >= 0.9 * max(place[0] for place in positions) else GREY
        share = 1.0 - RADIUS / math.dist(middle, at)  # the arm ends at the edge of the disc
        edge = (x0 - share * scale * y, y0 - share * scale * x)
        parts += [line(middle, edge, INK, 5.0)]
        parts += [disc(at, RADIUS, colour, 0.22)]
        parts += [turn(at, -spin, INK), text((at[0], at[1] + 5), f"{i}", size=16)]
        parts += [text((at[0], at[1] + 24), f"{'+' if spin > 0 else '−'}1", size=13)]
    parts += [disc(middle, 9, INK)]
    parts += [arrow(middle, (x0, y0 - 62), AXIS), text((x0 + 11, y0 - 52), "x", AXIS)]
    parts += [arrow(middle, (x0 - 62, y0), AXIS), text((x0 - 50, y0 + 17), "y", AXIS)]
    return parts


def from_the_side(left: float) -> list[str]:
    """Return a vehicle with its pole seen from the right side: x to the right, z up."""
    body, pivot, centre, tip = (left, 265.0), (left, 235.0), (left + 28, 140.0), (left + 52, 58.0)
    parts = [text((left + 10, 24), "pole and pivot, from the side", size=15)]
    for side in (-1, 1):
        hub = (left + 95 * side, 265.0)
        parts += [
            line(body, hub, INK, 5.0),
            line((hub[0] - 30, 254.0), (hub[0] + 30, 254.0), FRONT if side > 0 else GREY, 4.0),
        ]
        parts += [arrow((hub[0], 250.0), (hub[0], 205.0), INK)]
    parts += [text((left + 105, 216), "f", INK, "start"), line(body, pivot, GREY, 3.0), line(pivot, tip, POLE, 4.0)]
    parts += [disc(body, 8, INK), disc(pivot, 5, GREY), disc(centre, 7, POLE)]
    parts += [
        text((left - 12, 290), "centre of mass of the body, ζ", anchor="middle", size=13),
        text((left - 8, 226), "pivot, at p", anchor="end", size=13),
        text((left + 42, 145), "centre of mass", POLE, "start", 13),
        text((left + 42, 161), "m, J, at l from the pivot", POLE, "start", 13),
        text((left + 62, 62), "extent", POLE, "start", 13),
        arrow((left - 95, 130), (left - 60, 130), AXIS), text((left - 52, 135), "x", AXIS),
        arrow((left - 95, 130), (left - 95, 95), AXIS), text((left - 95, 88), "z", AXIS),
    ]  # fmt: skip
    return parts


def picture() -> str:
    """Return the picture as SVG."""
    heads = [
        f'<marker id="head{colour[1:]}" viewBox="0 0 10 10" refX="7" refY="5" markerWidth="6" markerHeight="6"'
        f' orient="auto"><path d="M0 0 10 5 0 10z" fill="{colour}"/></marker>'
        for colour in (INK, AXIS)
    ]
    parts = [
        *from_above(VEHICLES["hummingbird"], (160, 175), 105, "plus layout: hummingbird"),
        *from_above(VEHICLES["crazyflie"], (430, 175), 105, "X layout: all others"),
        *from_the_side(700),
    ]
    return "\n".join(
        [
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 920 320" font-family="sans-serif">',
            '<rect width="920" height="320" fill="#ffffff"/>',
            f"<defs>{''.join(heads)}</defs>",
            *parts,
            "</svg>\n",
        ]
    )


def vehicles_table() -> str:
    """Return the table of the presets."""
    columns = (
        "vehicle",
        "M, kg",
        "Ixx, Iyy, Izz, g·m²",
        "thrust, N",
        "κ",
        "lag, ms",
        "rate loop, ms",
        "pole",
        "1/√K, ms",
    )
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for name, vehicle in VEHICLES.items():
        inertia = ", ".join(f"{1e3 * moment:.3g}" for moment in vehicle.inertia_matrix.diagonal())
        pole = next(pole for pole, known in POLES.items() if known == vehicle.pole)
        rotors = ["–"] * 4
        if vehicle.rotors:
            parts, down = vehicle.rotors, vehicle.rotors.lag_down
            lags = "".join([f"{1e3 * parts.lag_up:g}", f", {1e3 * down:g}" if down else ""])
            thrust = "–".join(f"{number:g}" for number in parts.thrust)
            loop = f"{1e3 * vehicle.rate_loop.time_constant:g}"
            rotors = [thrust, f"{parts.torque_per_thrust:g}", lags, loop]
        fall = f"{1e3 / vehicle.stiffness**0.5:.0f}"
        lines.append(f"| {' | '.join([f'`{name}`', f'{vehicle.mass:g}', inertia, *rotors, f'`{pole}`', fall])} |")
    return "\n".join(lines)


def poles_table() -> str:
    """Return the table of the poles."""
    lines = ["| pole | m, g | l | J, g·m² | λ | full length |", "|---|---|---|---|---|---|"]
    for name, pole in POLES.items():
        numbers = [1e3 * pole.mass, pole.length, 1e3 * pole.inertia, pole.equivalent_length]
        extent = pole.full_length
        lines.append(f"| `{name}` | {' | '.join(f'{number:.3g}' for number in [*numbers, extent])} |")
    return "\n".join(lines)


def tables() -> dict[str, str]:
    """Return the generated parts of the page by name."""
    return {"vehicles": vehicles_table(), "poles": poles_table()}


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    fill(PAGE, tables())
