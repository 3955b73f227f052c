"""Validation: score a policy in its training scenarios, in episodes that are not used for training.

The scores of a run are its learning curve, in ``curve.csv``; a resumed run takes them from its checkpoint.
"""

import csv
import io
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.training.settings import TrainSettings

CURVE, BEST = "curve.csv", "best.npz"


class Score(NamedTuple):
    """One point of the learning curve.

    Attributes:
        steps: Timesteps of training before the evaluation.
        seconds: Duration of training before the evaluation, s.
        survival: Share of episodes without a fall, that is an early termination.
        penalised_rmse: Mean over all episodes of the root mean square of the tracking error, m; a fall counts as 1 m.
    """

    steps: int
    seconds: float
    survival: float
    penalised_rmse: float


def validate(policy: Policy, settings: TrainSettings, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Return survival and penalised RMSE (m) of a policy in the training scenarios of a run, see `Score`.

    They are means over `n_eval_episodes` episodes of each scenario, with different seeds in different scenarios.
    """
    episodes = settings.n_eval_episodes
    results = [
        run_episodes([policy], scenario, episodes, seed + number * episodes)
        for number, scenario in enumerate(settings.found().values())
    ]
    survived = np.concatenate([result.survived for result in results], axis=1)
    rmse = np.concatenate([result.penalised_rmse for result in results], axis=1)
    return float(survived.mean()), float(rmse.mean())


def read_curve(folder: Path) -> list[Score]:
    """Return the scores of all evaluations of a run so far; an empty list if there is no file."""
    if not (path := folder / CURVE).is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [Score(int(steps), *map(float, numbers)) for steps, *numbers in list(csv.reader(file))[1:]]


def write_curve(folder: Path, scores: list[Score]) -> None:
    """Replace the file of the scores."""
    lines = io.StringIO(newline="")
    csv.writer(lines).writerows([Score._fields, *scores])
    write_text(folder / CURVE, lines.getvalue())
