"""docs/results/learning.png: the scores of learned policies during training, from their cards.

python -m experiments.learning
"""

import numpy as np

from experiments.pages import DOCS
from experiments.results import LEARNED
from quadpend_train.policies.loading import policy_names
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import figures


def main() -> None:
    """Draw penalised RMSE and survival over wall-clock time, with a line for each training seed."""
    found = {name: [MlpPolicy.load(seed).card.get("curve", ()) for seed in policy_names(name)] for name in LEARNED}
    found = {name: [np.array(curve) for curve in curves] for name, curves in found.items() if len(curves[0]) > 1}
    figure = figures.new_figure(7.0, 4.5)
    ((rmse,), (survival,)) = figures.add_axes(figure, 2, 1, sharex=True)
    for i, (name, curves) in enumerate(found.items()):
        for number, (_, seconds, survived, error) in enumerate(curve.T for curve in curves):
            label = f"{name} ({len(curves)} seeds)" if number == 0 else None
            rmse.plot(seconds / 60.0, 1e3 * error, color=figures.colour(i), linewidth=1.0, label=label)
            survival.plot(seconds / 60.0, 1e2 * survived, color=figures.colour(i), linewidth=1.0)
    values = np.concatenate([1e3 * curve[:, 3] for curves in found.values() for curve in curves])
    figures.set_log_scale(rmse, values.min(), values.max())
    rmse.set_ylabel("penalised RMSE (mm)")
    survival.set_ylabel("survival (%)")
    survival.set_xlabel("training time on one core (min); each learner in its own training scenarios")
    rmse.legend(frameon=False)
    figures.write_png(figure, DOCS / "results/learning.png")


if __name__ == "__main__":
    main()
