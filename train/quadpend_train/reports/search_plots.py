"""Figures of searches: the value of each trial, and which parameters matter most."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import TrialState

from quadpend_train.common.text import figure_text
from quadpend_train.reports import figures
from quadpend_train.search.shared import quiet

_FEWEST = 4  # finished trials from which importances are computed


def importances(study: optuna.Study) -> Mapping[str, float]:
    """Return the share of each parameter in being among the best tenth of the trials (PED-ANOVA), the largest first.

    It is empty with fewer than four complete trials.
    """
    if len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))) < _FEWEST:
        return {}
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # if all trials have the same value
        return get_param_importances(study, evaluator=PedAnovaImportanceEvaluator())


def draw(study: optuna.Study, label: str, scale: float = 1.0) -> Any:
    """Draw the values of the trials in their order, and the importances of the parameters.

    Args:
        study: Study with at least one complete trial.
        label: Label of the values.
        scale: Factor on the values.
    """
    shares = importances(study)
    figure = figures.new_figure(9.0, max(3.2, 0.9 + 0.25 * len(shares)))
    ((history, bars),) = figures.add_axes(figure, 1, 2, width_ratios=(3, 2))
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    stopped = study.get_trials(deepcopy=False, states=(TrialState.PRUNED,))
    numbers = np.array([trial.number for trial in done])
    values = scale * np.array([trial.value for trial in done], dtype=float)
    history.plot(numbers, values, "o", color=figures.colour(0), markersize=4, label="complete")
    early = [(trial.number, scale * trial.value) for trial in stopped if trial.value is not None]
    if early:
        history.plot(*zip(*early, strict=True), "x", color=figures.colour(1), markersize=4, label="stopped early")
    history.step(numbers, np.minimum.accumulate(values), where="post", color=figures.colour(6), label="best so far")
    everything = [*values, *(value for _, value in early)]
    if min(everything) > 0.0:
        figures.set_log_scale(history, min(everything), max(everything))
    history.set_xlabel("trial")
    history.set_ylabel(label)
    history.legend(frameon=False)
    names = list(shares)[::-1]
    bars.barh(range(len(names)), [shares[name] for name in names], color=figures.colour(0), height=0.6)
    bars.set_yticks(range(len(names)), [figure_text(name) for name in names])
    bars.set_xlabel("importance (PED-ANOVA)" if shares else "importance: too few trials")
    return figure
