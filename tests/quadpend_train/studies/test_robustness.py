"""Robustness: survival falls under perturbations, and tolerance limits are interpolated correctly."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.studies.perturbations import PERTURBATION_AXES, PerturbationAxis
from quadpend_train.studies.recovery import CALM_HOVER, RecoveryOutcome
from quadpend_train.studies.robustness import (
    CurvePoint,
    Robustness,
    ToleranceLimit,
    format_tolerated_range,
    markdown,
    measure_robustness,
    tolerance_limit,
    tolerance_limits,
)
from tests.helpers.policies import brief_robustness


@pytest.fixture(scope="module")
def robustness() -> Robustness:
    return brief_robustness(4.0)


def points(axis: PerturbationAxis, survival: list[float]) -> list[CurvePoint]:
    nothing = Interval(0.0, 0.0, 0.0)
    return [
        CurvePoint(x, Interval(share, share - 0.05, share + 0.05), nothing, nothing)
        for x, share in zip(axis.values, survival, strict=True)
    ]


def test_adrc_survives_an_upright_start_and_falls_from_a_tilt_of_one_radian(robustness: Robustness) -> None:
    for policy in robustness.policies:
        upright, tilted = robustness.curves["tilt", policy]
        assert upright.survival.value == 1.0
        assert tilted.survival.value == 0.0
        assert np.isnan(tilted.rmse.value)
        assert tilted.penalised_rmse.value == 1.0


def test_the_tolerance_limit_is_interpolated_where_survival_first_falls_below_90_percent() -> None:
    assert tolerance_limit((0.0, 1.0, 2.0), (1.0, 0.8, 0.95)) == pytest.approx((0.5, True))
    assert tolerance_limit((0.0, 1.0), (1.0, 0.9)) == ToleranceLimit(1.0, False)
    assert tolerance_limit((1.0, 0.5), (1.0, 0.8)) == pytest.approx((0.75, True))
    assert np.isnan(tolerance_limit((0.0, 1.0), (0.5, 1.0)).value)


def test_a_tolerated_range_shows_its_intervals_and_the_end_of_the_axis() -> None:
    one_sided = PerturbationAxis("tilt", "rad", (0.0, 0.2, 0.4), lambda *_: {})
    assert format_tolerated_range(one_sided, points(one_sided, [1.0, 1.0, 0.8])) == "0.3 [0.25, 0.35]"
    assert format_tolerated_range(one_sided, points(one_sided, [1.0, 1.0, 1.0])) == "> 0.4"
    assert format_tolerated_range(one_sided, points(one_sided, [0.5, 0.2, 0.0])) == "– [–, –]"
    two_sided = PerturbationAxis("mass", "", (0.5, 1.0, 1.5), lambda *_: {}, nominal=1.0)
    lower, upper = tolerance_limits(two_sided, points(two_sided, [0.8, 1.0, 1.0]))
    assert lower == pytest.approx((0.75, True))
    assert upper == (1.5, False)
    assert format_tolerated_range(two_sided, points(two_sided, [0.8, 1.0, 1.0])) == "0.75 [0.62, 0.88] to > 1.5"


def test_adrc_started_at_hover_recovers_at_once_and_falls_from_a_large_tilt(robustness: Robustness) -> None:
    recovery = robustness.recovery_maps["tilt_rate", "one"]
    assert recovery.outcome.shape == (1, 5, 5)
    assert recovery.time[0, 2, 2] == 0.0
    assert recovery.outcome[0, 2, 0] == RecoveryOutcome.FELL


def test_robustness_is_written_as_json_and_as_a_table(robustness: Robustness, tmp_path: Path) -> None:
    robustness.save(tmp_path)
    data = json.loads((tmp_path / "robustness.json").read_text())
    assert data["axes"]["tilt"]["curves"]["one"][1]["survival"]["value"] == 0.0
    assert data["recovery"]["tilt_rate"]["maps"]["one"]["time"][0][2][2] == 0.0
    table = markdown(robustness)
    assert table.startswith("|  | one | other |\n| --- | --- | --- |\n| initial tilt (rad) | ")
    assert len(table.splitlines()) == 5


def test_jobs_with_different_starts_have_separate_cached_results(tmp_path: Path) -> None:
    options = PERTURBATION_AXES["tilt"].options(1.0, 3, 0)
    hover = replace(CALM_HOVER, duration=2.0)
    jobs = {"calm": Job("adrc-paper", hover, 3, 0), "tilted": Job("adrc-paper", hover, 3, 0, options)}
    first = run_jobs(jobs, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    assert first["calm"].survived.all()
    assert not first["tilted"].survived.any()
    alone = run_episodes([ADRC("paper")], hover, 3, 0, options)
    np.testing.assert_array_equal(first["tilted"].error, alone.error)
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = run_jobs(jobs, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == stamps
    np.testing.assert_array_equal(again["tilted"].error, first["tilted"].error)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policies": {}}, "policies must have at least one entry"),
        ({"policies": {"a": "adrc-paper"}, "episodes": 0}, "episodes must be"),
    ],
)
def test_wrong_arguments_are_refused_and_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        measure_robustness(**arguments)
