"""A brief measurement of robustness, for tests of the study and of its plots."""

from dataclasses import replace

from quadpend_baselines import ADRC
from quadpend_train.studies.perturbations import PERTURBATION_AXES
from quadpend_train.studies.recovery import START_GRIDS, StartGrid
from quadpend_train.studies.robustness import Robustness, measure_robustness

AXES = {
    "tilt": replace(PERTURBATION_AXES["tilt"], values=(0.0, 1.0)),
    "mass": replace(PERTURBATION_AXES["mass"], values=(0.8, 1.0, 1.5)),
}


def small_grid() -> StartGrid:
    """The grid over tilt and tilt rate with 5 × 5 starts."""
    grid = START_GRIDS["tilt_rate"]
    x, y = (axis._replace(values=axis.values[::6]) for axis in (grid.x, grid.y))
    return replace(grid, x=x, y=y)


def brief_robustness() -> Robustness:
    """The robustness of two ADRC controllers on two axes and one grid."""
    policies = {"one": [ADRC("paper")], "other": [ADRC("matched")]}
    return measure_robustness(policies, AXES, {"tilt_rate": small_grid()}, episodes=8)
