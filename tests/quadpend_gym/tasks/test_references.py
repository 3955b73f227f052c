"""References: exact derivatives, shapes, random references, and random starts near them."""

import copy
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Reference, ReferenceSettings, StartSettings, Task
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks import TASKS
from tests.helpers.envs import make_unwrapped, make_vec

FAMILIES = (
    "hover",
    "circle",
    "figure_eight",
    "helix",
    "slalom",
)  # fields of `ReferenceSettings` with relative frequencies

GENERAL = Reference(
    offset=(0.1, -0.2, 2.5, 0.3),
    rate=(0.5, 0.05, -0.1, 0.02),
    amplitude=(0.5, -0.4, 0.1, 0.2),
    frequency=(1.0, 2.0, -1.5, 0.7),
    phase=(0.1, 2.2, -0.3, 5.0),
)
TIMES = np.linspace(0.0, 10.0, 201)
GRAVITY, ROD = 9.8, 0.3
NO_DEVIATION = StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_derivatives_agree_with_sympy() -> None:
    t = sympy.Symbol("t")
    derivatives = GENERAL.derivatives(TIMES)
    for channel in range(4):
        offset, rate, amplitude, frequency, phase = GENERAL.as_array().reshape(5, 4)[:, channel]
        function = offset + rate * t + amplitude * sympy.sin(frequency * t + phase)
        for order in range(7):
            exact = sympy.lambdify(t, sympy.diff(function, t, order) + 0 * t, "numpy")(TIMES)
            assert_allclose(derivatives[:, order, channel], exact, rtol=1e-12, atol=1e-12)


def test_derivatives_have_the_shape_of_the_times() -> None:
    assert GENERAL.derivatives(1.0).shape == (7, 4)
    assert GENERAL.derivatives(TIMES.reshape(3, 67)).shape == (3, 67, 7, 4)
    assert_array_equal(GENERAL.derivatives(TIMES.reshape(3, 67)).reshape(201, 7, 4), GENERAL.derivatives(TIMES))


def test_a_hover_reference_is_constant() -> None:
    derivatives = Reference.hover(1.0, 2.0, 3.0, yaw=0.4).derivatives(TIMES)
    assert_array_equal(derivatives[:, 0], np.broadcast_to((1.0, 2.0, 3.0, 0.4), (201, 4)))
    assert_array_equal(derivatives[:, 1:], 0.0)


@pytest.mark.parametrize("frequency", [1.3, -1.3])
def test_a_circle_has_the_given_radius_and_angular_frequency(frequency: float) -> None:
    (x, y, z, _), (vx, vy, *_) = np.moveaxis(Reference.circle(0.8, frequency, 2.5).derivatives(TIMES)[:, :2], 0, -1)
    assert_allclose(np.hypot(x, y), 0.8, rtol=1e-12)
    assert_allclose(x * vy - y * vx, frequency * 0.8**2, rtol=1e-12)
    assert_array_equal(z, 2.5)
    assert (x[0], y[0]) == (0.8, 0.0)


def test_a_helix_is_a_circle_that_climbs() -> None:
    helix, circle = (Reference.circle(0.8, 1.3, climb=climb).derivatives(TIMES) for climb in (0.2, 0.0))
    assert_array_equal(helix[:, :, [0, 1, 3]], circle[:, :, [0, 1, 3]])
    assert_allclose(helix[:, 0, 2], 2.0 + 0.2 * TIMES, rtol=1e-15)


def test_a_figure_eight_is_the_lemniscate_of_gerono() -> None:
    """x⁴ = R² (x² − y²), with the period 2π/ω."""
    radius, frequency = 0.9, 2.0
    x, y, z, _ = Reference.figure_eight(radius, frequency).derivatives(TIMES)[:, 0].T
    assert_allclose(x**4, radius**2 * (x**2 - y**2), atol=1e-14)
    assert_allclose(np.abs(x).max(), radius, rtol=1e-3)
    assert_array_equal(z, 2.0)
    again = Reference.figure_eight(radius, frequency).derivatives(TIMES + 2.0 * np.pi / frequency)
    assert_allclose(again[:, 0, 0], x, atol=1e-12)


def single_family(family: str, **settings: Any) -> Task:
    """Return a task whose references are all of one family."""
    return Task(references=ReferenceSettings(**{**dict.fromkeys(FAMILIES, 0.0), family: 1.0, **settings}))


@cache
def drawn(task: Task, rows: int = 500) -> list[Reference]:
    """Return references that a task draws."""
    env = make_vec(rows, task=task)
    env.reset(seed=0)
    return [Reference(*numbers.reshape(5, 4)) for numbers in env.world.reference]


@pytest.mark.parametrize("family", FAMILIES)
def test_drawn_references_lie_within_the_ranges_of_their_task(family: str) -> None:
    ranges = ReferenceSettings()
    times = np.linspace(0.0, 40.0, 4001)
    heights, sizes, peaks, climbs = [], [], [], []
    for reference in drawn(single_family(family), 200):
        derivatives = reference.derivatives(times)
        heights.append(derivatives[0, 0, 2])
        sizes.append(np.abs(derivatives[:, 0, 1 if family == "slalom" else 0]).max())
        peaks.append(np.hypot(derivatives[:, 2, 0], derivatives[:, 2, 1]).max())
        climbs.append(derivatives[0, 1, 2])
    assert ranges.height[0] <= min(heights) < max(heights) <= ranges.height[1]
    if family == "hover":
        assert max(sizes) == max(peaks) == 0.0
    else:
        # The grid of times contains the peaks only approximately.
        assert 0.999 * ranges.radius[0] < min(sizes) < 0.4 < 1.4 < max(sizes) < ranges.radius[1]
        assert 0.999 * ranges.acceleration[0] < min(peaks) < 0.25 < 0.95 < max(peaks) < 1.0001 * ranges.acceleration[1]
    if family == "helix":
        assert ranges.climb[0] <= min(climbs) < 0.0 < max(climbs) <= ranges.climb[1]
    else:
        assert_array_equal(climbs, 0.0)


@pytest.mark.parametrize("family", FAMILIES)
def test_drawn_yaw_references_lie_within_the_ranges_of_their_task(family: str) -> None:
    offsets, amplitudes, frequencies = np.array(
        [(r.offset[3], r.amplitude[3], r.frequency[3]) for r in drawn(single_family(family))]
    ).T
    for drawn_values, low, high in ((offsets, -0.5, 0.5), (amplitudes, 0.0, 0.3), (frequencies, 0.0, 1.0)):
        assert low <= drawn_values.min() < low + 0.02
        assert high - 0.02 < drawn_values.max() <= high


def family_of(reference: Reference) -> str:
    """Return the family of a drawn reference."""
    if reference.amplitude[0] == 0.0:
        return "slalom" if reference.amplitude[1] else "hover"
    if reference.rate[2] != 0.0:
        return "helix"
    return "circle" if reference.frequency[1] == reference.frequency[0] else "figure_eight"


def test_families_are_drawn_with_their_relative_frequencies() -> None:
    task = Task(references=ReferenceSettings(hover=1.0, circle=2.0, figure_eight=3.0, helix=4.0, slalom=10.0))
    names = [family_of(reference) for reference in drawn(task, 5000)]
    assert_allclose([names.count(family) / 5000 for family in FAMILIES], [0.05, 0.1, 0.15, 0.2, 0.5], atol=0.03)


@pytest.mark.parametrize("family", ["circle", "figure_eight", "helix"])
def test_drawn_references_have_both_directions_of_rotation_and_all_phases(family: str) -> None:
    points = np.array([reference.derivatives(0.0)[:2, :2] for reference in drawn(single_family(family))])
    (x, y), (vx, vy) = points.transpose(1, 2, 0)
    counterclockwise = x * vy - y * vx > 0.0
    assert 0.4 < counterclockwise.mean() < 0.6
    for quadrant in range(4):
        inside = (x > 0.0) == (quadrant % 2), (y > 0.0) == (quadrant // 2)
        assert 0.15 < np.mean(inside[0] & inside[1]) < 0.35


def test_a_slalom_moves_forward_with_a_velocity_within_its_range_in_both_directions() -> None:
    velocities = np.array([reference.derivatives(TIMES)[:, 1, 0] for reference in drawn(single_family("slalom"))])
    assert_array_equal(velocities, np.broadcast_to(velocities[:, :1], velocities.shape))
    low, high = ReferenceSettings().speed
    speeds = np.abs(velocities[:, 0])
    assert low <= speeds.min() < low + 0.04
    assert high - 0.04 < speeds.max() <= high
    assert 0.4 < np.mean(velocities[:, 0] > 0.0) < 0.6


def test_without_slaloms_all_numbers_are_those_of_the_other_families() -> None:
    """A new family at the end changes no draw, also if its speed is another one."""
    usual, other = (drawn(Task(references=ReferenceSettings(speed=speed)), 50) for speed in ((1.0, 3.0), (5.0, 6.0)))
    assert usual == other


def test_the_hover_task_has_one_height_and_one_yaw() -> None:
    points = np.array([reference.derivatives(TIMES) for reference in drawn(TASKS["hover"], 20)])
    assert_array_equal(points[:, :, 0], np.broadcast_to((0.0, 0.0, 2.0, 0.0), (20, 201, 4)))
    assert_array_equal(points[:, :, 1:], 0.0)


def exact_start(reference: Reference) -> dict[str, Floats]:
    """Return the state that tracks a reference of constant height, from r ∥ F̈ + g e₃ and central differences."""
    step = 1e-4
    times = np.array([-step, 0.0, step])
    lift = reference.derivatives(times)[:, 2, :3] + (0.0, 0.0, GRAVITY)
    r = lift / np.linalg.norm(lift, axis=-1, keepdims=True)
    bob = reference.derivatives(times)[:, 0, :3]
    position = np.concatenate([bob[:, :2] - ROD * r[:, :2], bob[:, 2:]], axis=-1)
    rates = [(part[2] - part[0]) / (2.0 * step) for part in (position, r)]
    return {"position": position[1], "velocity": rates[0], "direction": r[1], "direction_rate": rates[1]}


@pytest.mark.parametrize("family", FAMILIES)
def test_starts_without_deviation_track_the_reference(family: str) -> None:
    env = make_unwrapped(task=Task(references=single_family(family, climb=(0.0, 0.0)).references, start=NO_DEVIATION))
    for seed in range(20):
        _, info = env.reset(seed=seed)
        reference = Reference(*env.world.reference[0].reshape(5, 4))
        assert_allclose(info["tracking_error"], 0.0, atol=1e-14)
        for name, value in exact_start(reference).items():
            assert_allclose(getattr(env.state, name), value, atol=2e-5, err_msg=name)
        assert_allclose(env.state.euler[2], reference.derivatives(0.0)[0, 3], rtol=1e-14)


def shifted(reference: Reference, time: float) -> Reference:
    """Return the trajectory that starts `time` seconds later on the same path."""
    numbers = reference.as_array().reshape(5, 4)
    _, rate, _, frequency, _ = numbers
    return Reference(*(numbers + np.outer((time, 0, 0, 0, 0), rate) + np.outer((0, 0, 0, 0, time), frequency)))


@pytest.mark.parametrize("family", FAMILIES)
def test_rates_of_a_start_without_deviation_are_derivatives_along_the_reference(family: str) -> None:
    step, still_yaw = 1e-4, {"yaw_amplitude": 0.0}
    env = make_vec(
        50, task=Task(references=single_family(family, climb=(0.0, 0.0), **still_yaw).references, start=NO_DEVIATION)
    )
    env.reset(seed=0)
    references = [Reference(*numbers.reshape(5, 4)) for numbers in env.world.reference]
    states = []
    for time in (-step, 0.0, step):
        env.reset(options={"reference": [shifted(reference, time) for reference in references]})
        states.append(copy.deepcopy(env.state))
    before, now, after = states
    for name, rate in (("position", "velocity"), ("euler", "euler_rate"), ("direction", "direction_rate")):
        difference = (getattr(after, name) - getattr(before, name)) / (2.0 * step)
        assert_allclose(getattr(now, rate), difference, atol=1e-7, err_msg=rate)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_tilt_of_a_start_without_deviation_gives_the_pendulum_the_required_acceleration(family: str) -> None:
    """Near upright the acceleration of the bob is g r, so r̈ must be F⁽⁴⁾ / g."""
    small = {"radius": (0.02, 0.03), "acceleration": (0.05, 0.1), "climb": (0.0, 0.0)}
    env = make_vec(50, task=Task(references=single_family(family, **small).references, start=NO_DEVIATION))
    env.reset(seed=0)
    hover_command = np.array([PAPER.hover_thrust, 0.0, 0.0, 0.0])
    swing = accelerations(env.state.array, hover_command, np.zeros(DISTURBANCE_SIZE), PAPER).direction
    fourth = [Reference(*numbers.reshape(5, 4)).derivatives(0.0)[4, :2] for numbers in env.world.reference]
    assert_allclose(swing[:, :2], np.array(fourth) / GRAVITY, atol=1e-3)


START_FIELDS = {
    "position": "position",
    "velocity": "velocity",
    "angle": "euler",
    "angle_rate": "euler_rate",
    "direction": "direction",
    "direction_rate": "direction_rate",
}


@pytest.mark.parametrize(("setting", "field"), START_FIELDS.items())
def test_starts_deviate_from_the_reference_up_to_the_given_size(setting: str, field: str) -> None:
    size = 0.05
    no_deviation = dict.fromkeys(START_FIELDS, 0.0)
    references = single_family("hover").references
    env = make_vec(1000, task=Task(references=references, start=StartSettings(**{**no_deviation, setting: size})))
    exact = make_vec(1000, task=Task(references=references, start=StartSettings(**no_deviation)))
    env.reset(seed=0), exact.reset(seed=0)
    deviation = getattr(env.state, field) - getattr(exact.state, field)
    # The normalisation of r and the projection of ṙ leave no deviation along z.
    drawn_part = deviation[:, :2] if setting.startswith("direction") else deviation
    limit = 1.06 * size if setting == "direction" else size * (1.0 + 1e-9)
    assert (0.95 * size < np.abs(drawn_part).max(axis=0)).all()
    assert np.abs(deviation).max() <= limit
    assert_allclose(drawn_part.mean(axis=0), 0.0, atol=0.1 * size)
