"""A memory of the observation `LAB` as inputs of a network: relative, and without samples that tell nothing new."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpend_baselines.estimation.samples import MOST_REFUSED
from quadpend_baselines.hybrid import LabOnly, VectorHybridWrapper
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.hybrid.lab import FILTER, FOLLOWING, NEAR, OUTPUT, REACH, VERTICAL_REACH, lab_part
from quadpend_baselines.hybrid.parts import Seen
from quadpend_baselines.hybrid.scheduled_gain import MEASURED, NOISE
from quadpend_gym import Simulation
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.tasks.observation import LAB

SCENARIO = replace(find_scenario("flight_training_motion"), sensors=())
POSITION, DIRECTION, ORIENTATION = (LAB.columns[name] for name in ("position", "direction", "quaternion"))
LAGS, SINCE = np.r_[tuple(slice(12 * j, 12 * j + 8) for j in range(1, 5))], 71  # the lags of m
INNOVATION = slice(NEAR.start - len(MEASURED), NEAR.start)


def seen_in(observations: Any) -> Any:
    """Return the inputs for observations in turn, shape (steps, n, 114), while zero actions are applied."""
    hybrid, memory, out = LabOnly().flown_in(SCENARIO.simulation), None, []
    for step, observation in enumerate(observations):
        seen, memory = hybrid.observe(observation, memory, np.full(len(observation), step == 0))
        memory = hybrid.act(np.zeros((len(observation), 4), np.float32), memory)[1]
        out.append(seen)
    return np.array(out)


@pytest.fixture(scope="module")
def flown() -> Any:
    """Return observations of a fall along a reference, shape (12, 1, 36)."""
    env, idle = SCENARIO.make_vec(1), np.zeros((1, 4), np.float32)
    return np.array([env.reset(seed=3)[0], *(env.step(idle)[0] for _ in range(11))])


def test_the_inputs_do_not_depend_on_place_and_heading(flown: Any) -> None:
    moved, angle = flown.copy(), 0.7
    sine, cosine = np.sin(angle), np.cos(angle)
    for name in LAB:
        first = LAB.columns[name].start
        if name in ("position", "direction") or name.startswith("reference"):
            x, y = flown[..., first], flown[..., first + 1]
            moved[..., first], moved[..., first + 1] = cosine * x - sine * y, sine * x + cosine * y
    for first in (POSITION.start, LAB.columns["reference_0"].start):
        moved[..., first : first + 3] += np.array([20.0, -8.0, 5.0])
    moved[..., LAB.columns["yaw_reference"].start] += angle
    w, x, y, z = np.moveaxis(flown[..., ORIENTATION], -1, 0)
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    moved[..., ORIENTATION] = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=-1)
    np.testing.assert_allclose(seen_in(moved), seen_in(flown), rtol=2e-3, atol=5e-3)  # of 2e-6 m


def test_a_whole_turn_of_the_yaw_reference_changes_nothing(flown: Any) -> None:
    turned = flown.copy()
    turned[6:, :, LAB.columns["yaw_reference"].start] += 2.0 * np.pi
    np.testing.assert_allclose(seen_in(turned), seen_in(flown), rtol=1e-3, atol=1e-3)


def test_samples_that_repeat_or_lie_far_away_are_not_taken(flown: Any) -> None:
    expected = seen_in(flown)
    assert (expected[..., SINCE] == 0.0).all()
    assert np.abs(expected[-1, :, LAGS]).max() > 0.05
    for disturbed in (None, POSITION, ORIENTATION, DIRECTION):
        given = flown.copy()
        if disturbed is None:
            for columns in (POSITION, ORIENTATION, DIRECTION):
                given[5:8, :, columns] = flown[4, :, columns]
        elif disturbed is ORIENTATION:
            given[5:8, :, ORIENTATION] = flown[5:8, :, ORIENTATION][..., [1, 0, 3, 2]]  # half a turn
        else:
            given[5:8, :, disturbed.start] += 1.0
        seen = seen_in(given)
        np.testing.assert_allclose(seen[7, :, :8], np.exp(-0.03 / 0.1) * seen[4, :, :8], rtol=1e-5)
        np.testing.assert_allclose(seen[7, :, SINCE], 0.03 / 0.05, rtol=1e-6)
        np.testing.assert_allclose(seen[8, :, :8], expected[8, :, :8], rtol=1e-6)
        np.testing.assert_allclose(
            seen[8, :, LAGS], expected[8, :, LAGS], atol=0.1 * np.abs(expected[8, :, LAGS]).max()
        )


def test_samples_that_stay_elsewhere_are_a_step_of_the_measurements(flown: Any) -> None:
    given, refused = flown.copy(), range(3, 3 + MOST_REFUSED)
    given[3:, :, POSITION.start] += 1.0
    seen, expected, step = seen_in(given), seen_in(flown), refused.stop
    np.testing.assert_allclose(seen[refused, 0, SINCE], 0.2 * np.arange(1, MOST_REFUSED + 1), rtol=1e-6)
    np.testing.assert_array_equal(seen[step:, :, SINCE], 0.0)
    np.testing.assert_array_equal(seen[step, :, INNOVATION], 0.0)
    np.testing.assert_allclose(seen[step, :, 2:8], expected[step, :, 2:8], atol=1e-6)
    times = np.repeat([0.03, 0.12, 0.5, 2.0], 8)
    np.testing.assert_allclose(seen[step, :, LAGS], np.exp(-0.06 / times)[:, np.newaxis] * seen[2, :, LAGS], rtol=1e-5)


def test_a_sample_that_is_taken_ends_a_row_of_refused_ones(flown: Any) -> None:
    given, near = flown.copy(), 1 + MOST_REFUSED
    given[1:near, :, POSITION.start] += 1.0
    given[near + 1 :, :, POSITION.start] += 1.0
    expected = [*range(near), *range(len(flown) - near)]
    assert len(flown) - near == 1 + MOST_REFUSED
    np.testing.assert_allclose(seen_in(given)[:, 0, SINCE], 0.2 * np.array(expected), rtol=1e-6)


def test_errors_of_position_count_up_to_a_limit(flown: Any) -> None:
    z = slice(FILTER.start, FILTER.start + 3)
    for horizontal, vertical in ((0.5, -0.8), (6.0, -6.0)):
        given = flown[:1].copy()
        for axis, distance in ((0, horizontal), (2, vertical)):
            given[..., LAB.columns["reference_0"].start + axis] -= distance / LAB.scale[POSITION][axis]
        seen = seen_in(given)[0, 0]
        for error, scale in ((seen[:3], 0.05), (seen[z], deviation_scales(1.0)[4])):
            np.testing.assert_allclose(np.hypot(*error[:2]) * scale, min(horizontal, REACH), rtol=0.05)
            np.testing.assert_allclose(error[2] * scale, max(vertical, -VERTICAL_REACH), rtol=0.05)


@pytest.mark.parametrize(
    ("columns", "value"), [(POSITION, np.nan), (ORIENTATION, 0.0), (ORIENTATION, np.nan), (DIRECTION, np.inf)]
)
def test_a_sample_that_is_not_finite_is_not_taken(flown: Any, columns: slice, value: float) -> None:
    """A quaternion of zeros has no attitude. However long they last, the inputs do not begin anew at such samples."""
    given, repeated, lost = flown.copy(), flown.copy(), slice(3, 5 + MOST_REFUSED)
    given[lost, :, columns] = value
    for same in (POSITION, ORIENTATION, DIRECTION):
        repeated[lost, :, same] = flown[2, :, same]
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(seen_in(given), seen_in(repeated))


def test_measurements_count_less_the_noisier_they_are(flown: Any) -> None:
    seen = Seen(flown[0], np.zeros((1, 4), np.float32), *[np.zeros((1, 4))] * 3)
    usual, noisy = (lab_part(SCENARIO.simulation, noise) for noise in (NOISE, (4.0 * NOISE[0], *NOISE[1:])))
    memory = np.zeros((1, usual.memory_size))
    (first, _), (second, _) = (part.function(part.numbers, seen, memory) for part in (usual, noisy))
    np.testing.assert_allclose(second[:, :3], 0.25 * first[:, :3])
    np.testing.assert_array_equal(second[:, 3:8], first[:, 3:8])


@pytest.mark.parametrize(("feedback", "columns"), [(True, NEAR), (False, FOLLOWING)])
def test_the_policy_adds_to_the_linear_feedback_or_to_the_command_of_the_trajectory(
    flown: Any, feedback: bool, columns: slice
) -> None:
    hybrid = LabOnly(feedback=feedback).flown_in(SCENARIO.simulation)
    seen, memory = hybrid.observe(flown[0], None, np.ones(1, np.bool_))
    assert np.abs(seen[:, columns]).max() > 1e-3
    for action in (0.0, 0.25, 1.0):
        applied, _ = hybrid.act(np.full((1, 4), action, np.float32), memory)
        np.testing.assert_array_equal(applied, np.clip(seen[:, columns] + np.float32(OUTPUT * action), -1.0, 1.0))


def test_the_environment_must_have_positions_and_a_rigid_vehicle(flown: Any) -> None:
    scenario = replace(SCENARIO, observation="output_feedback")
    with pytest.raises(ValueError, match="give the environment observation='lab'"):
        VectorHybridWrapper(scenario.make_vec(1), LabOnly())
    with pytest.raises(ValueError, match="flies rigid vehicles, not paper"):
        LabOnly().flown_in(Simulation()).observe(flown[0], None, np.ones(1, np.bool_))
