"""Validation: score a policy in its training scenarios, in episodes that are not used for training.

The scores of a run are its learning curve, in the file ``curve.csv``. The file is for its readers: a resumed run takes
the scores from its checkpoint.
"""

import csv
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import expand_sets
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.policies.mlp_policy import MlpPolicy
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
    """Run a policy in the training scenarios of a run.

    Args:
        policy: The policy. As in evaluation, `Policy.adapt` adapts it to each scenario.
        settings: The settings of the run.
        seed: The seed of the first episode of the first scenario; episodes of different scenarios have different seeds.

    Returns:
        Survival and penalised RMSE (m), see `Score`; means over `n_eval_episodes` episodes of each scenario.
    """
    episodes = settings.n_eval_episodes
    results = [
        run_episodes([policy], name, episodes, seed + number * episodes)
        for number, name in enumerate(expand_sets(settings.scenarios))
    ]
    survived = np.concatenate([result.survived for result in results], axis=1)
    rmse = np.concatenate([result.penalised_rmse for result in results], axis=1)
    return float(survived.mean()), float(rmse.mean())


def read_curve(folder: Path) -> list[Score]:
    """Return the scores of all evaluations of a run so far; an empty list if there is no file.

    Raises:
        ValueError: If the file is damaged.
    """
    path = folder / CURVE
    if not path.is_file():
        return []
    try:
        text = path.read_bytes().decode("utf-8")
        head, *rows = csv.reader(io.StringIO(text, newline=""), strict=True)
        scores = [Score(int(steps), *map(float, numbers)) for steps, *numbers in rows]
        whole = tuple(head) == Score._fields and text.endswith("\n")
    except (ValueError, TypeError, csv.Error):
        whole, scores = False, []
    if not whole or not all(0.0 <= score.survival <= 1.0 and 0.0 <= score.penalised_rmse <= 1.0 for score in scores):
        raise ValueError(_damaged(path, "it is cut off or contains something else than scores"))
    return scores


def write_curve(folder: Path, scores: list[Score]) -> None:
    """Replace the file of the scores."""
    lines = io.StringIO(newline="")
    csv.writer(lines).writerows([Score._fields, *scores])
    write_text(folder / CURVE, lines.getvalue())


def restore_scores(model: Any, settings: TrainSettings, folder: Path) -> None:
    """Give a model that an earlier version has saved the scores and the best policy, which are in files of its run.

    Args:
        model: A model from a checkpoint or of a finished run; those of this version contain both.
        settings: The settings of the run.
        folder: The folder of the run.

    Raises:
        ValueError: If one of the files is damaged or missing.
    """
    if hasattr(model, "scores"):
        return
    model.scores = [score for score in read_curve(folder) if score.steps <= model.num_timesteps]
    if not settings.eval_freq:
        return
    if not model.scores:
        raise ValueError(_damaged(folder / CURVE, "it lacks the evaluation after 0 timesteps"))
    try:
        MlpPolicy.load(folder / BEST)
    except ValueError as error:
        reason = str(error) if (folder / BEST).is_file() else "it does not exist"
        raise ValueError(_damaged(folder / BEST, reason)) from None
    model.best = (folder / BEST).read_bytes()


def _damaged(path: Path, reason: str) -> str:
    return f"{path} is damaged: {reason}; restore the file, or train again in another folder"
