"""How learned policies came to be: their scores while they trained, from their cards."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import figures

Curves = Mapping[
    str, Sequence[Floats]
]  # by learner, one array for each seed: steps, seconds, survival, RMSE in columns


def of(policies: Mapping[str, Sequence[Any]]) -> dict[str, list[Floats]]:
    """The curves of those policies that are learned, and were looked at while they trained."""
    found: dict[str, list[Floats]] = {}
    for name, members in policies.items():
        cards = [policy.card for policy in members if isinstance(policy, MlpPolicy)]
        curves = [np.array(card["curve"]) for card in cards if len(card.get("curve", ())) > 1]
        if curves:
            found[name] = curves
    return found


def draw(curves: Curves) -> Any:
    """Penalised RMSE in the training scenarios over wall-clock, a line for each seed, and survival below."""
    figure = figures.blank(7.0, 4.5)
    ((above,), (below,)) = figures.grid(figure, 2, 1, sharex=True)
    for i, (name, seeds) in enumerate(curves.items()):
        for number, curve in enumerate(seeds):
            label = f"{name} ({len(seeds)} seeds)" if number == 0 else None
            minutes = curve[:, 1] / 60.0
            above.plot(minutes, 1e3 * curve[:, 3], color=figures.colour(i), linewidth=1.0, label=label)
            below.plot(minutes, 1e2 * curve[:, 2], color=figures.colour(i), linewidth=1.0)
    every = np.concatenate([1e3 * curve[:, 3] for seeds in curves.values() for curve in seeds])
    figures.logarithmic(above, every.min(), every.max())
    above.set_ylabel("penalised RMSE (mm)")
    below.set_ylabel("survival (%)")
    below.set_xlabel("training, minutes on one core; each learner in its own training scenarios")
    above.legend(frameon=False)
    return figure
