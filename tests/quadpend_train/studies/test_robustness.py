"""Robustness: trouble grows while all else stays, edges are where they should be, maps are what they say."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import ADRC
from quadpend_gym.physics.state import State
from quadpend_train.common.documents import fill
from quadpend_train.evaluation.episodes import STEPS, EpisodeResults, run_episodes
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures, robustness_plots
from quadpend_train.scenarios import Scenario
from quadpend_train.studies.attraction import CALM_HOVER, MAPS, Map, RecoveryMap, RecoveryOutcome, Side, classify
from quadpend_train.studies.axes import AXES, Axis
from quadpend_train.studies.robustness import (
    Edge,
    Point,
    Robustness,
    edge,
    edges,
    markdown,
    measure_robustness,
    tolerated_range,
)

SMALL = {"tilt": replace(AXES["tilt"], values=(0.0, 1.0)), "mass": replace(AXES["mass"], values=(0.8, 1.0, 1.5))}


def small_map() -> dict[str, Map]:
    x, y = (side._replace(values=side.values[::6]) for side in (MAPS["tilt_rate"].x, MAPS["tilt_rate"].y))
    return {"tilt_rate": replace(MAPS["tilt_rate"], x=x, y=y)}


@pytest.fixture(scope="module")
def measured() -> Robustness:
    return measure_robustness({"one": [ADRC("paper")], "other": [ADRC("matched")]}, SMALL, small_map(), episodes=8)


def started(axis: Axis, value: float, episodes: int = 6, seed: int = 0) -> Any:
    env = axis.scenario(value).make_vec(episodes, AutoresetMode.SAME_STEP)
    env.reset(seed=seed, options=axis.options(value, episodes, seed))
    return env.unwrapped


def points(axis: Axis, survival: list[float]) -> list[Point]:
    nothing = Interval(0.0, 0.0, 0.0)
    return [
        Point(x, Interval(share, share - 0.05, share + 0.05), nothing, nothing)
        for x, share in zip(axis.values, survival, strict=True)
    ]


def test_adrc_survives_no_tilt_and_falls_from_one_radian(measured: Robustness) -> None:
    for policy in measured.policies:
        upright, toppled = measured.curves["tilt", policy]
        assert upright.survival.value == 1.0
        assert toppled.survival.value == 0.0
        assert np.isnan(toppled.rmse.value)
        assert toppled.penalised_rmse.value == 1.0


@pytest.mark.parametrize("name", AXES)
def test_along_an_axis_only_the_trouble_changes(name: str) -> None:
    axis = AXES[name]
    least, most = (started(axis, value).world for value in (axis.values[0], axis.values[-1]))
    np.testing.assert_array_equal(least.reference, most.reference)
    changed = {"tilt": range(12, 18), "offset": range(3), "rod": range(12)}.get(name, ())  # a start fits its rod
    same = [i for i in range(18) if i not in changed]
    np.testing.assert_array_equal(least.state[:, same], most.state[:, same])


def test_starts_are_exactly_as_far_as_the_axis_says_in_directions_of_the_seed() -> None:
    state = State(started(AXES["tilt"], 0.4).world.state)
    np.testing.assert_allclose(state.alpha, 0.4, atol=1e-12)
    np.testing.assert_allclose(state.beta, State(started(AXES["tilt"], 0.1).world.state).beta, atol=1e-12)
    assert np.ptp(np.sort(np.diff(np.sort(state.beta)))) < 1.5
    np.testing.assert_allclose(State(started(AXES["tilt"], 0.4, 2, seed=4).world.state).beta, state.beta[4:], atol=1e-9)
    position = State(started(AXES["offset"], 1.5).world.state).position
    np.testing.assert_allclose(np.hypot(*position.T[:2]), 1.5, atol=1e-12)
    np.testing.assert_allclose(position[:, 2], 2.0)


@pytest.mark.parametrize("name", AXES)
def test_every_axis_ascends_and_has_its_nominal_value(name: str) -> None:
    axis = AXES[name]
    assert list(axis.values) == sorted(set(axis.values))
    assert axis.nominal in axis.values


def test_a_plant_of_other_mass_is_not_told_to_the_controller() -> None:
    env = started(AXES["mass"], 1.5)
    np.testing.assert_allclose(env.world.parameters[:, :2], [[0.75, 0.3]] * 6)
    assert AXES["mass"].scenario(1.5).simulation == Scenario().simulation


def test_the_edge_is_interpolated_where_survival_first_falls_below_90_percent() -> None:
    assert edge((0.0, 1.0, 2.0), (1.0, 0.8, 0.95)) == pytest.approx((0.5, True))
    assert edge((0.0, 1.0), (1.0, 0.9)) == Edge(1.0, False)
    assert edge((1.0, 0.5), (1.0, 0.8)) == pytest.approx((0.75, True))
    assert np.isnan(edge((0.0, 1.0), (0.5, 1.0)).value)


def test_an_edge_is_told_with_its_interval_and_where_the_axis_ends() -> None:
    one_sided = Axis("tilt", "rad", (0.0, 0.2, 0.4), lambda _: CALM_HOVER)
    assert tolerated_range(one_sided, points(one_sided, [1.0, 1.0, 0.8])) == "0.3 [0.25, 0.35]"
    assert tolerated_range(one_sided, points(one_sided, [1.0, 1.0, 1.0])) == "> 0.4"
    assert tolerated_range(one_sided, points(one_sided, [0.5, 0.2, 0.0])) == "– [–, –]"
    two_sided = Axis("mass", "", (0.5, 1.0, 1.5), lambda _: CALM_HOVER, nominal=1.0)
    downwards, upwards = edges(two_sided, points(two_sided, [0.8, 1.0, 1.0]))
    assert downwards == pytest.approx((0.75, True))
    assert upwards == (1.5, False)
    assert tolerated_range(two_sided, points(two_sided, [0.8, 1.0, 1.0])) == "0.75 [0.62, 0.88] to > 1.5"


@pytest.mark.parametrize("name", MAPS)
def test_a_map_starts_on_a_grid_symmetric_about_rest(name: str) -> None:
    state = MAPS[name].options()["state"]
    size = MAPS[name].x.values.size * MAPS[name].y.values.size
    assert size == 625
    mirrored = {"position": [-1, -1, 1], "direction": [-1, -1, 1], "direction_rate": [-1, -1, 1]}
    for field, signs in mirrored.items():
        vectors = np.broadcast_to(state[field], (size, 3))
        np.testing.assert_allclose(vectors[::-1] * signs, vectors, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(state["direction"], axis=1), 1.0)
    np.testing.assert_allclose(state["direction"] @ np.array([0.0, 1.0, 0.0]), 0.0)
    rate = np.broadcast_to(state["direction_rate"], (size, 3))
    np.testing.assert_allclose(np.sum(rate * state["direction"], axis=1), 0.0, atol=1e-12)


def test_a_map_knows_who_fell_who_settled_and_when() -> None:
    error = np.full((1, 3, STEPS), 0.2, np.float32)
    error[0, 1, 250:] = 0.01
    error[0, 2, 30:] = np.nan
    empty = dict.fromkeys(EpisodeResults._fields, np.zeros((1, 3)))
    flights = EpisodeResults(**{**empty, "survived": np.array([[True, True, False]]), "error": error})
    item = Map("", Side("", "", np.arange(3.0)), Side("", "", np.zeros(1)), MAPS["tilt_rate"].start)
    basin = classify(flights, item)
    assert basin.outcome.tolist() == [[[RecoveryOutcome.UNSETTLED, RecoveryOutcome.RECOVERED, RecoveryOutcome.FELL]]]
    np.testing.assert_allclose(basin.time, [[[np.nan, 2.5, np.nan]]])
    assert basin.recovered == pytest.approx(1 / 3)


def test_from_rest_at_hover_adrc_recovers_at_once(measured: Robustness) -> None:
    basin = measured.basins["tilt_rate", "one"]
    assert basin.outcome.shape == (1, 5, 5)
    assert basin.time[0, 2, 2] == 0.0
    assert basin.outcome[0, 2, 0] == RecoveryOutcome.FELL


def test_numbers_go_to_json_and_to_a_table(measured: Robustness, tmp_path: Path) -> None:
    measured.save(tmp_path)
    data = json.loads((tmp_path / "robustness.json").read_text())
    assert data["axes"]["tilt"]["curves"]["one"][1]["survival"]["value"] == 0.0
    assert data["maps"]["tilt_rate"]["basins"]["one"]["time"][0][2][2] == 0.0
    table = markdown(measured)
    assert table.startswith("|  | one | other |\n| --- | --- | --- |\n| initial tilt (rad) | ")
    assert len(table.splitlines()) == 5


def test_pictures_are_the_same_each_time(measured: Robustness, tmp_path: Path) -> None:
    for name in ("first", "second"):
        figures.png(robustness_plots.curves(measured), tmp_path / f"{name}.png")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()
    figures.png(robustness_plots.maps(measured, "tilt_rate"), tmp_path / "maps.png")
    assert (tmp_path / "maps.png").stat().st_size > 5_000


def test_of_several_training_seeds_the_map_shows_what_most_do() -> None:
    outcome = np.array([[[2, 0]], [[2, 0]], [[0, 2]]])
    basin = RecoveryMap(outcome, np.where(outcome == 2, 1.0, np.nan))
    assert basin.recovered == 0.5
    item = Map("", Side("a", "", np.array([-1.0, 1.0])), Side("b", "", np.array([-1.0, 1.0])), MAPS["tilt_rate"].start)
    assert "data:image/png" in figures.svg(robustness_plots.map_figure(item, basin), "map")


def test_jobs_are_flown_once_and_their_starts_tell_them_apart(tmp_path: Path) -> None:
    options = AXES["tilt"].options(1.0, 3, 0)
    jobs = {"calm": Job("adrc-paper", CALM_HOVER, 3, 0), "toppled": Job("adrc-paper", CALM_HOVER, 3, 0, options)}
    first = run_jobs(jobs, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    assert first["calm"].survived.all()
    assert not first["toppled"].survived.any()
    np.testing.assert_array_equal(
        first["toppled"].error, run_episodes([ADRC("paper")], CALM_HOVER, 3, 0, options).error
    )
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = run_jobs(jobs, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == stamps
    np.testing.assert_array_equal(again["toppled"].error, first["toppled"].error)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"policies": {}}, "at least one policy"), ({"policies": {"a": "adrc-paper"}, "episodes": 0}, "episodes must be")],
)
def test_mistakes_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        measure_robustness(**arguments)


def test_generated_parts_fill_their_places_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "results.md"
    path.write_text("Before\n<!-- begin table -->\nold\n<!-- end table -->\nAfter\n")
    fill(path, {"table": "| \\1 new |\n"})
    once = path.read_text()
    assert once == "Before\n<!-- begin table -->\n\n| \\1 new |\n\n<!-- end table -->\nAfter\n"
    fill(path, {"table": "| \\1 new |\n"})
    assert path.read_text() == once
    with pytest.raises(ValueError, match="one place for 'other', not 0"):
        fill(path, {"other": ""})
