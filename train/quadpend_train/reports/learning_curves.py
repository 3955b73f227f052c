"""Learning curves: the scores of learned policies during training, from their cards."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.common.text import figure_text
from quadpend_train.evaluation.jobs import Learner
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import figures

# One array for each training seed of a learner, by its name; columns: steps, seconds, survival, penalised RMSE in m.
Curves = Mapping[str, Sequence[Floats]]


def collect(learners: Mapping[str, Learner]) -> dict[str, list[Floats]]:
    """Return the learning curves of those learners that were evaluated during their training."""
    found: dict[str, list[Floats]] = {}
    for name, learner in learners.items():
        cards = [policy.card for policy in learner.policies if isinstance(policy, MlpPolicy)]
        curves = [np.array(card["curve"]) for card in cards if len(card.get("curve", ())) > 1]
        if curves:
            found[name] = curves
    return found


def draw(curves: Curves) -> Any:
    """Draw penalised RMSE and survival over wall-clock time, with a line for each training seed.

    Args:
        curves: Learning curves, see `collect`.
    """
    figure = figures.new_figure(7.0, 4.5)
    ((rmse,), (survival,)) = figures.add_axes(figure, 2, 1, sharex=True)
    for i, (name, seeds) in enumerate(curves.items()):
        for number, curve in enumerate(seeds):
            label = f"{figure_text(name)} ({len(seeds)} seeds)" if number == 0 else None
            minutes = curve[:, 1] / 60.0
            rmse.plot(minutes, 1e3 * curve[:, 3], color=figures.colour(i), linewidth=1.0, label=label)
            survival.plot(minutes, 1e2 * curve[:, 2], color=figures.colour(i), linewidth=1.0)
    values = np.concatenate([1e3 * curve[:, 3] for seeds in curves.values() for curve in seeds])
    figures.set_log_scale(rmse, values.min(), values.max())
    rmse.set_ylabel("penalised RMSE (mm)")
    survival.set_ylabel("survival (%)")
    survival.set_xlabel("training time on one core (min); each learner in its own training scenarios")
    rmse.legend(frameon=False)
    return figure
