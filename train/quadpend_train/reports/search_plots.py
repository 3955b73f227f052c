"""Figures of searches: the value of each trial, and which parameters matter most."""

import warnings
from typing import Any

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import TrialState

from quadpend_train.common.text import figure_text
from quadpend_train.reports import figures
from quadpend_train.search.shared import quiet

_FEWEST = 4  # finished trials from which importances are computed


def draw(study: optuna.Study, label: str, scale: float = 1.0) -> Any:
    """Draw the values of the trials, times `scale`, in their order, and the importances of the parameters.

    An importance is the share of a parameter in being among the best tenth of the trials (PED-ANOVA).
    """
    done, stopped = (
        np.array([(t.number, scale * t.value) for t in study.trials if t.state == state and t.value is not None])
        for state in (TrialState.COMPLETE, TrialState.PRUNED)
    )
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # if all trials have the same value
        evaluator = PedAnovaImportanceEvaluator()
        shares = get_param_importances(study, evaluator=evaluator) if len(done) >= _FEWEST else {}
    figure = figures.new_figure(9.0, max(3.2, 0.9 + 0.25 * len(shares)))
    ((history, bars),) = figures.add_axes(figure, 1, 2, width_ratios=(3, 2))
    history.plot(*done.T, "o", color=figures.colour(0), markersize=4, label="complete")
    if len(stopped):
        history.plot(*stopped.T, "x", color=figures.colour(1), markersize=4, label="stopped early")
    best = np.minimum.accumulate(done[:, 1])
    history.step(done[:, 0], best, where="post", color=figures.colour(6), label="best so far")
    values = np.array([*done, *stopped])[:, 1]
    if values.min() > 0.0:
        figures.set_log_scale(history, values.min(), values.max())
    history.set(xlabel="trial", ylabel=label)
    history.legend(frameon=False)
    names = list(shares)[::-1]
    bars.barh(range(len(names)), [shares[name] for name in names], color=figures.colour(0), height=0.6)
    bars.set_yticks(range(len(names)), [figure_text(name) for name in names])
    bars.set_xlabel("importance (PED-ANOVA)" if shares else "importance: too few trials")
    return figure
