"""Waypoints and sinusoids: exact derivatives, continuity, minimum snap, and what a trajectory demands."""

import json
import pickle
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import BPoly

from quadpend_gym import PAPER, Reference, Simulation, Waypoints
from quadpend_gym.core.arrays import Floats
from quadpend_gym.tasks.feasibility import check_feasible, demand
from quadpend_gym.tasks.trajectories import as_trajectory

TOUR = Waypoints((0, 2, 3.5, 6), ((0, 0, 2), (0.5, 0.2, 2.5, 0.4), (1.0, 1.0, 2.0), (0.0, 1.0, 1.8, -0.5)))
LAP = Waypoints((0, 2, 4, 6, 8), ((1, 0, 2), (0, 1, 2, 0.3), (-1, 0, 2.2), (0, -1, 2), (1, 0, 2)), closed=True)
SINUSOIDS = Reference(
    offset=(0.1, -0.2, 2.5, 0.3),
    rate=(0.5, 0.05, -0.1, 0.02),
    amplitude=(0.5, -0.4, 0.1, 0.2),
    frequency=(1.0, 2.0, -1.5, 0.7),
    phase=(0.1, 2.2, -0.3, 5.0),
)
TRAJECTORIES = {"waypoints": TOUR, "closed waypoints": LAP, "sinusoids": SINUSOIDS}
each = pytest.mark.parametrize("trajectory", TRAJECTORIES.values(), ids=TRAJECTORIES.keys())
NOW_AND_THEN = np.array([-1.3, 0.1, 1.9, 3.1, 5.0, 7.7, 12.4])


def difference(trajectory: Any, times: Floats, order: int, step: float = 1e-3) -> Floats:
    """The derivative of the given order as a central difference of order 4 of the derivative below."""
    below = [trajectory.derivatives(times + k * step)[:, order - 1] for k in (-2, -1, 1, 2)]
    return np.asarray((below[0] - 8.0 * below[1] + 8.0 * below[2] - below[3]) / (12.0 * step))


@each
@pytest.mark.parametrize("order", range(1, 7))
def test_every_derivative_is_that_of_the_one_below(trajectory: Any, order: int) -> None:
    derivatives = trajectory.derivatives(NOW_AND_THEN)
    assert derivatives.shape == (7, 7, 4)
    assert_allclose(derivatives[:, order], difference(trajectory, NOW_AND_THEN, order), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("trajectory", [TOUR, LAP])
def test_waypoints_are_met_and_all_derivatives_are_continuous_there(trajectory: Waypoints) -> None:
    times = np.array(trajectory.times)
    assert_allclose(trajectory.derivatives(times)[:, 0], trajectory.points, atol=1e-12)
    before, after = trajectory.derivatives(times - 1e-10), trajectory.derivatives(times + 1e-10)
    assert_allclose(before, after, atol=1e-5)


def test_waypoints_rest_before_the_first_and_after_the_last_time() -> None:
    at = TOUR.derivatives(np.array([-5.0, -0.1, 6.0, 6.1, 1000.0]))
    assert_array_equal(at[:, 0], np.array(TOUR.points)[[0, 0, 3, 3, 3]])
    assert_array_equal(at[:, 1:], 0.0)


def test_closed_waypoints_repeat_without_stopping() -> None:
    times = np.linspace(0.1, 7.9, 20)
    assert_allclose(LAP.derivatives(times + 16.0), LAP.derivatives(times), rtol=1e-9, atol=1e-9)
    assert np.abs(LAP.derivatives(8.0)[1]).max() > 0.3


def snap_cost(times: Floats, derivatives: Floats) -> tuple[float, Any]:
    """The integral of the squared snap of the Hermite spline of degree 13 with these derivatives, and the spline."""
    spline = BPoly.from_derivatives(times, derivatives)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    h = np.diff(times)[:, np.newaxis]
    snap = spline.derivative(4)(times[:-1, np.newaxis] + 0.5 * h * (nodes + 1.0))
    return float(np.sum(0.5 * h * weights * snap**2)), spline


@pytest.mark.parametrize("channel", range(2))
def test_no_other_spline_of_this_kind_through_the_points_has_less_snap(channel: int) -> None:
    times = np.array(TOUR.times)
    derivatives = TOUR.derivatives(times)[:, :, channel]
    cost, spline = snap_cost(times, derivatives)
    between = np.linspace(0.0, 6.0, 50)
    assert_allclose(TOUR.derivatives(between)[:, 0, channel], spline(between), atol=1e-9)
    generator = np.random.default_rng(0)
    for _ in range(5):
        change = np.zeros(derivatives.shape)
        change[1:-1, 1:] = 0.01 * generator.standard_normal((2, 6))
        more, less = (snap_cost(times, derivatives + sign * change)[0] for sign in (1.0, -1.0))
        assert min(more, less) > cost
        assert_allclose(more, less, rtol=1e-5)  # the cost is quadratic about its minimum


@each
def test_a_trajectory_survives_json_and_pickle_and_is_hashable(trajectory: Any) -> None:
    assert as_trajectory(json.loads(json.dumps(asdict(trajectory))), "trajectory") == trajectory
    copied = pickle.loads(pickle.dumps(trajectory))
    assert copied == trajectory
    assert hash(copied) == hash(trajectory)


def test_a_trajectory_beyond_the_thrust_is_refused_with_time_and_number() -> None:
    with pytest.raises(ValueError, match=r"needs a thrust of 18.0\d N at \d+\.\d\d s, but the largest is 13.72 N"):
        check_feasible(Reference.circle(1.0, np.sqrt(20.0)), Simulation())
    drop = Waypoints((0, 0.9), ((0, 0, 4), (0, 0, 1)))
    with pytest.raises(ValueError, match=r"needs a pendulum tilt of 180.0° at 0.\d\d s, where it must be below 90°"):
        check_feasible(drop, Simulation())


def test_a_trajectory_that_is_free_fall_at_one_time_is_refused() -> None:
    """There a pole has no direction that follows it."""
    fall = Reference(amplitude=(0, 0, 9.8, 0), frequency=(0, 0, 1, 0), phase=(0, 0, np.pi / 2, 0))
    with pytest.raises(ValueError, match=r"needs a pendulum tilt of 90.0° at 0.00 s"):
        check_feasible(fall, Simulation())


def test_hovering_demands_the_weight_and_no_tilt() -> None:
    needed = demand(Reference(), PAPER, np.array([0.0, 1.0]))
    assert_allclose(needed.thrust, PAPER.hover_thrust, rtol=1e-14)
    assert_array_equal([needed.pendulum_angle, needed.body_angle], 0.0)
