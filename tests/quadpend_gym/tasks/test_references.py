"""References: shapes, random references, and random starts near them."""

import copy
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Reference, ReferenceSettings, StartSettings, Task
from tests.helpers.envs import make_vec
from tests.helpers.physics import rates

FAMILIES = ("hover", "circle", "figure_eight", "helix", "slalom")  # fields of `ReferenceSettings`
every_family = pytest.mark.parametrize("family", FAMILIES)
TIMES = np.linspace(0.0, 10.0, 201)
GRAVITY, ROD = 9.8, 0.3
NO_DEVIATION = StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("frequency", [1.3, -1.3])
def test_a_circle_has_the_given_radius_and_frequency_and_a_helix_climbs(frequency: float) -> None:
    circle, helix = (Reference.circle(0.8, frequency, 2.5, climb).derivatives(TIMES) for climb in (0.0, 0.2))
    (x, y, z, _), (vx, vy, *_) = np.moveaxis(circle[:, :2], 0, -1)
    assert_allclose(np.hypot(x, y), 0.8, rtol=1e-12)
    assert_allclose(x * vy - y * vx, frequency * 0.8**2, rtol=1e-12)
    assert_array_equal(z, 2.5)
    assert_array_equal(helix[:, :, [0, 1, 3]], circle[:, :, [0, 1, 3]])
    assert_allclose(helix[:, 0, 2], 2.5 + 0.2 * TIMES, rtol=1e-15)


def test_a_figure_eight_is_the_lemniscate_of_gerono() -> None:
    """x⁴ = R² (x² − y²), with the period 2π/ω."""
    radius, frequency = 0.9, 2.0
    eight = Reference.figure_eight(radius, frequency)
    x, y, z, _ = eight.derivatives(TIMES)[:, 0].T
    assert_allclose(x**4, radius**2 * (x**2 - y**2), atol=1e-14)
    assert_allclose(np.abs(x).max(), radius, rtol=1e-3)
    assert_array_equal(z, 2.0)
    assert_allclose(eight.derivatives(TIMES + 2.0 * np.pi / frequency)[:, 0, 0], x, atol=1e-12)


def single_family(family: str, **settings: Any) -> Task:
    """Return a task whose references are all of one family."""
    return Task(references=ReferenceSettings(**{**dict.fromkeys(FAMILIES, 0.0), family: 1.0, **settings}))


@cache
def drawn(task: Task, rows: int = 500) -> list[Reference]:
    """Return references that a task draws."""
    env = make_vec(rows, task=task)
    env.reset(seed=0)
    return [Reference.from_array(numbers) for numbers in env.world.reference]


@every_family
def test_drawn_references_lie_within_the_ranges_of_their_task(family: str) -> None:
    ranges, times = ReferenceSettings(), np.linspace(0.0, 40.0, 4001)
    references = drawn(single_family(family), 200)
    derivatives = np.array([reference.derivatives(times) for reference in references])
    heights, climbs = derivatives[:, 0, 0, 2], derivatives[:, 0, 1, 2]
    sizes = np.abs(derivatives[:, :, 0, 1 if family == "slalom" else 0]).max(axis=1)
    peaks = np.hypot(derivatives[:, :, 2, 0], derivatives[:, :, 2, 1]).max(axis=1)
    speeds = np.abs(derivatives[:, :, 1, 0])
    assert ranges.height[0] <= min(heights) < max(heights) <= ranges.height[1]
    if family == "hover":
        assert max(sizes) == max(peaks) == 0.0
    else:  # the grid of times contains the peaks only approximately
        assert 0.999 * ranges.radius[0] < min(sizes) < 0.4 < 1.4 < max(sizes) < ranges.radius[1]
        assert 0.999 * ranges.acceleration[0] < min(peaks) < 0.25 < 0.95 < max(peaks) < 1.0001 * ranges.acceleration[1]
        assert 0.4 < np.mean(np.sign(derivatives[:, 0, 1, 0]) > 0.0) < 0.6  # both directions
    low, high = ranges.climb if family == "helix" else (0.0, 0.0)
    assert low <= min(climbs) <= max(climbs) <= high
    if family == "slalom":
        assert_array_equal(speeds, np.broadcast_to(speeds[:, :1], speeds.shape))
        assert ranges.speed[0] <= speeds.min() < 1.1 < 2.9 < speeds.max() <= ranges.speed[1]
    yaws = np.array([(r.offset[3], r.amplitude[3], r.frequency[3]) for r in references])
    assert ((yaws >= (-0.5, 0.0, 0.0)) & (yaws <= (0.5, 0.3, 1.0))).all()
    assert np.ptp(yaws, axis=0) == pytest.approx([1.0, 0.3, 1.0], rel=0.1)


def test_families_are_drawn_with_their_relative_frequencies() -> None:
    task = Task(references=ReferenceSettings(hover=1.0, circle=2.0, figure_eight=3.0, helix=4.0, slalom=10.0))
    found = drawn(task, 5000)
    shares = {
        "hover": [reference.amplitude[:2] == (0.0, 0.0) for reference in found],
        "helix": [reference.rate[2] != 0.0 for reference in found],
        "slalom": [reference.rate[0] != 0.0 for reference in found],
    }
    assert_allclose([np.mean(shares[name]) for name in ("hover", "helix", "slalom")], [0.05, 0.2, 0.5], atol=0.03)


def shifted(reference: Reference, time: float) -> Reference:
    """Return the trajectory that starts `time` seconds later on the same path."""
    numbers = reference.as_array().reshape(5, 4)
    _, rate, _, frequency, _ = numbers
    return Reference(*(numbers + np.outer((time, 0, 0, 0, 0), rate) + np.outer((0, 0, 0, 0, time), frequency)))


@every_family
@pytest.mark.parametrize("vehicle", ["paper", "hummingbird"])
def test_a_start_without_deviation_is_on_the_reference_and_moves_along_it(vehicle: str, family: str) -> None:
    step, still = 1e-4, {"climb": (0.0, 0.0), "yaw_amplitude": 0.0}
    task = Task(references=single_family(family, **still).references, start=NO_DEVIATION)
    env = make_vec(50, vehicle=vehicle, task=task)
    env.reset(seed=0)
    references = [Reference.from_array(numbers) for numbers in env.world.reference]
    states = []
    for time in (-step, 0.0, step):
        _, info = env.reset(options={"reference": [shifted(reference, time) for reference in references]})
        assert_allclose(info["tracking_error"], 0.0, atol=1e-14)
        states.append(copy.deepcopy(env.state))
    before, now, after = states
    if vehicle == "paper":  # a pole with inertia leans less
        lift = np.add([reference.derivatives(0.0)[2, :3] for reference in references], (0.0, 0.0, GRAVITY))
        assert_allclose(now.direction, lift / np.linalg.norm(lift, axis=-1, keepdims=True), atol=1e-12)
    for name, rate in (("position", "velocity"), ("euler", "euler_rate"), ("direction", "direction_rate")):
        difference = (getattr(after, name) - getattr(before, name)) / (2.0 * step)
        assert_allclose(getattr(now, rate), difference, atol=1e-7, err_msg=rate)


@every_family
@pytest.mark.parametrize(("pendulum", "side"), [("upright", 1.0), ("hanging", -1.0)])
def test_the_body_of_a_start_gives_bob_and_pendulum_the_required_acceleration(
    family: str, pendulum: Any, side: float
) -> None:
    """Near the vertical the acceleration of the bob is g r, so r̈ must be F⁽⁴⁾ / g."""
    small = {"radius": (0.02, 0.03), "acceleration": (0.05, 0.1), "climb": (0.0, 0.0)}
    references = single_family(family, **small).references
    env = make_vec(50, task=Task(references=references, start=NO_DEVIATION, pendulum=pendulum))
    env.reset(seed=0)
    found = rates(env.state.array, np.array([PAPER.hover_thrust, 0.0, 0.0, 0.0]), np.zeros(9), PAPER)
    derivatives = np.array([Reference.from_array(row).derivatives(0.0) for row in env.world.reference])
    assert_allclose(found.direction_rate[:, :2], side * derivatives[:, 4, :2] / GRAVITY, atol=2e-3)
    bob = found.velocity[:, :2] + ROD * found.direction_rate[:, :2]
    assert_allclose(bob, derivatives[:, 2, :2], atol=2e-3)


START_FIELDS = {"position": "position", "velocity": "velocity", "angle": "euler", "angle_rate": "euler_rate"}
START_FIELDS |= {"direction": "direction", "direction_rate": "direction_rate"}


@pytest.mark.parametrize(("setting", "field"), START_FIELDS.items())
def test_starts_deviate_from_the_reference_up_to_the_given_size(setting: str, field: str) -> None:
    size, references = 0.05, single_family("hover").references
    settings = {**dict.fromkeys(START_FIELDS, 0.0), setting: size}
    env = make_vec(1000, task=Task(references=references, start=StartSettings(**settings)))
    exact = make_vec(1000, task=Task(references=references, start=NO_DEVIATION))
    env.reset(seed=0), exact.reset(seed=0)
    deviation = getattr(env.state, field) - getattr(exact.state, field)
    # The normalisation of r and the projection of ṙ leave no deviation along z.
    drawn_part = deviation[:, :2] if setting.startswith("direction") else deviation
    assert (0.95 * size < np.abs(drawn_part).max(axis=0)).all()
    assert np.abs(deviation).max() <= (1.06 * size if setting == "direction" else size * (1.0 + 1e-9))
    assert_allclose(drawn_part.mean(axis=0), 0.0, atol=0.1 * size)
