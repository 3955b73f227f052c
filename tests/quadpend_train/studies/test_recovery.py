"""Starts of recovery maps lie on a symmetric grid, and their outcomes are classified correctly."""

from dataclasses import replace

import numpy as np
import pytest

from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.studies.recovery import START_GRIDS, RecoveryMap, RecoveryOutcome, classify_recovery


@pytest.mark.parametrize("name", START_GRIDS)
def test_a_grid_of_starts_is_symmetric_about_hover(name: str) -> None:
    state = START_GRIDS[name].options()["state"]
    size = START_GRIDS[name].x.values.size * START_GRIDS[name].y.values.size
    assert size == 625
    mirrored = {"position": [-1, -1, 1], "direction": [-1, -1, 1], "direction_rate": [-1, -1, 1]}
    for field, signs in mirrored.items():
        vectors = np.broadcast_to(state[field], (size, 3))
        np.testing.assert_allclose(vectors[::-1] * signs, vectors, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(state["direction"], axis=1), 1.0)
    np.testing.assert_allclose(state["direction"] @ np.array([0.0, 1.0, 0.0]), 0.0)
    rate = np.broadcast_to(state["direction_rate"], (size, 3))
    np.testing.assert_allclose(np.sum(rate * state["direction"], axis=1), 0.0, atol=1e-12)


def test_starts_are_classified_and_have_their_time_to_recover() -> None:
    error = np.full((1, 3, EPISODE_STEPS), 0.2, np.float32)
    error[0, 1, 250:] = 0.01
    error[0, 2, 30:] = np.nan
    empty = dict.fromkeys(EpisodeResults._fields, np.zeros((1, 3)))
    results = EpisodeResults(**{**empty, "survived": np.array([[True, True, False]]), "error": error})
    grid = START_GRIDS["tilt_rate"]
    x, y = grid.x._replace(values=np.arange(3.0)), grid.y._replace(values=np.zeros(1))
    found = classify_recovery(results, replace(grid, x=x, y=y), 0.01)
    assert found.outcome.tolist() == [[[RecoveryOutcome.UNSETTLED, RecoveryOutcome.RECOVERED, RecoveryOutcome.FELL]]]
    np.testing.assert_allclose(found.time, [[[np.nan, 2.5, np.nan]]])
    assert found.recovered == pytest.approx(1 / 3)


def test_the_share_of_recovered_starts_counts_all_training_seeds() -> None:
    outcome = np.array([[[2, 0]], [[2, 0]], [[0, 2]]])
    assert RecoveryMap(outcome, np.where(outcome == 2, 1.0, np.nan)).recovered == 0.5
