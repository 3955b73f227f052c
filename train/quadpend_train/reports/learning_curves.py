"""Learning curves: the scores of learned policies during training, from their cards."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadpend_baselines import Policy
from quadpend_train.common.text import figure_text
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import figures


def draw(learners: Mapping[str, Sequence[Policy]]) -> Any:
    """Draw penalised RMSE and survival over wall-clock time, with a line for each training seed.

    The figure shows the learners that were evaluated during their training; None if there are none.
    """
    found: dict[str, list[Any]] = {}  # columns of a curve: steps, seconds, survival, penalised RMSE in m
    for name, policies in learners.items():
        for policy in policies:
            if isinstance(policy, MlpPolicy) and len(policy.card.get("curve", ())) > 1:
                found.setdefault(name, []).append(np.array(policy.card["curve"]))
    if not found:
        return None
    figure = figures.new_figure(7.0, 4.5)
    ((rmse,), (survival,)) = figures.add_axes(figure, 2, 1, sharex=True)
    for i, (name, curves) in enumerate(found.items()):
        for number, curve in enumerate(curves):
            label = f"{figure_text(name)} ({len(curves)} seeds)" if number == 0 else None
            minutes = curve[:, 1] / 60.0
            rmse.plot(minutes, 1e3 * curve[:, 3], color=figures.colour(i), linewidth=1.0, label=label)
            survival.plot(minutes, 1e2 * curve[:, 2], color=figures.colour(i), linewidth=1.0)
    values = np.concatenate([1e3 * curve[:, 3] for curves in found.values() for curve in curves])
    figures.set_log_scale(rmse, values.min(), values.max())
    rmse.set_ylabel("penalised RMSE (mm)")
    survival.set_ylabel("survival (%)")
    survival.set_xlabel("training time on one core (min); each learner in its own training scenarios")
    rmse.legend(frameon=False)
    return figure
