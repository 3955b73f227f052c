"""Plots of robustness are reproducible and show all policies."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from quadpend_train.reports import figures, robustness_plots
from quadpend_train.studies.recovery import START_GRIDS, GridAxis, RecoveryMap
from tests.helpers.policies import brief_robustness


def test_plots_of_robustness_are_reproducible(tmp_path: Path) -> None:
    robustness = brief_robustness(1.0)
    for name in ("first", "second"):
        figures.write_png(robustness_plots.curves(robustness), tmp_path / f"{name}.png")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()
    figures.write_png(robustness_plots.maps(robustness, "tilt_rate"), tmp_path / "maps.png")
    assert (tmp_path / "maps.png").stat().st_size > 5_000


def test_the_map_of_several_training_seeds_is_drawn() -> None:
    outcome = np.array([[[2, 0]], [[2, 0]], [[0, 2]]])
    recovery = RecoveryMap(outcome, np.where(outcome == 2, 1.0, np.nan))
    x, y = GridAxis("a", "", np.array([-1.0, 1.0])), GridAxis("b", "", np.array([-1.0, 1.0]))
    figure = robustness_plots.map_figure(replace(START_GRIDS["tilt_rate"], x=x, y=y), recovery)
    assert "data:image/png" in figures.to_svg(figure, "map")
