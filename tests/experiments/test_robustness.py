"""Perturbations change one thing, starts are consistent, and limits are interpolated correctly."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from experiments import robustness, vehicles
from experiments.perturbations import PERTURBATION_AXES, PerturbationAxis
from experiments.robustness import tolerance_limit, tolerated_range
from quadpend_train.evaluation.recovery import settling_times
from quadpend_train.evaluation.statistics import Interval


def reset_env(axis: PerturbationAxis, value: float, episodes: int = 6, seed: int = 0) -> Any:
    env = axis.scenario(value).make_vec(episodes, AutoresetMode.SAME_STEP)
    env.reset(seed=seed, options=axis.options(value, episodes, seed))
    return env.unwrapped


@pytest.mark.parametrize("name", PERTURBATION_AXES)
def test_only_the_perturbation_changes_along_an_axis(name: str) -> None:
    axis = PERTURBATION_AXES[name]
    least, most = (reset_env(axis, value).world for value in (axis.values[0], axis.values[-1]))
    np.testing.assert_array_equal(least.reference, most.reference)
    changed = {"tilt": range(12, 18), "offset": range(3), "rod": range(12)}.get(name, ())  # starts depend on the rod
    same = [i for i in range(18) if i not in changed]
    np.testing.assert_array_equal(least.state[:, same], most.state[:, same])
    assert list(axis.values) == sorted(set(axis.values))
    assert axis.nominal in axis.values


def test_a_settling_time_ends_the_last_step_with_a_large_error() -> None:
    inside, outside = [0.01] * 3, [0.1] * 3
    error = [outside + inside, inside + outside, [0.01, 0.2] + [0.01] * 4, inside * 2, [0.01] + [np.nan] * 5]
    found = settling_times(np.array([[True, True, True, True, False]]), np.array([error]), 0.5)
    np.testing.assert_allclose(found, [[1.5, np.nan, 1.0, 0.0, np.nan]])


def test_starts_are_those_of_a_pole_that_turns_about_its_pivot() -> None:
    state = vehicles.starts(np.array([0.0, 0.5]), np.array([2.0, 0.0]))["state"]
    np.testing.assert_allclose(np.linalg.norm(state["direction"], axis=1), 1.0)
    np.testing.assert_allclose(np.sum(state["direction_rate"] * state["direction"], axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(state["direction_rate"], axis=1), [2.0, 0.0])


def test_the_largest_recovered_value_has_no_failure_below_it() -> None:
    values = np.array([0.0, 0.1, 0.2, 0.3])
    nan = np.nan
    for times, largest in (([2, 2, nan, 2], 0.1), ([2, 2, 2, 2], 0.3), ([nan, 2, 2, 2], nan), ([2, nan, nan, 2], 0.0)):
        np.testing.assert_equal(vehicles.largest_recovered(np.array([times]), values), largest)


def test_the_tolerance_limit_is_interpolated_where_survival_first_falls_below_90_percent() -> None:
    assert tolerance_limit((0.0, 1.0, 2.0), (100.0, 80.0, 95.0)) == pytest.approx(0.5)
    assert tolerance_limit((0.0, 1.0), (100.0, 90.0)) == np.inf
    assert tolerance_limit((1.0, 0.5), (100.0, 80.0)) == pytest.approx(0.75)
    assert np.isnan(tolerance_limit((0.0, 1.0), (50.0, 100.0)))


def test_a_tolerated_range_shows_its_intervals_and_the_end_of_the_axis() -> None:
    def text(axis: PerturbationAxis, *survival: float) -> str:
        return tolerated_range(axis, [{"survival": Interval(share, share - 5.0, share + 5.0)} for share in survival])

    one_sided = PerturbationAxis("tilt", "rad", (0.0, 0.2, 0.4), lambda *_: {})
    assert text(one_sided, 100.0, 100.0, 80.0) == "0.3 [0.25, 0.35]"
    assert text(one_sided, 100.0, 100.0, 100.0) == "> 0.4"
    assert text(one_sided, 50.0, 20.0, 0.0) == "– [–, –]"
    two_sided = PerturbationAxis("mass", "", (0.5, 1.0, 1.5), lambda *_: {}, nominal=1.0)
    assert text(two_sided, 80.0, 100.0, 100.0) == "0.75 [0.62, 0.88] to > 1.5"


def test_adrc_survives_at_hover_falls_from_a_large_tilt_and_both_are_drawn() -> None:
    axis = replace(PERTURBATION_AXES["tilt"], values=(0.0, 1.0))
    found = robustness.measure({"one": "adrc-paper"}, 4, 0, {"tilt": axis})
    upright, tilted = found.curves["tilt", "one"]
    assert (upright["survival"].value, tilted["survival"].value) == (100.0, 0.0)
    assert tilted["penalised_rmse"].value == 1000.0
    assert robustness.markdown(found).startswith("|  | one |\n| --- | --- |\n| initial tilt (rad) | ")
    assert len(robustness.draw_curves(found).axes) == 6
