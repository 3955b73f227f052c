"""Validation: score a policy in its training scenarios, in episodes that are not used for training.

The scores of a run are its learning curve, in the file ``curve.csv``. Which policy is the best depends on them, so a
damaged file is refused.
"""

import csv
import io
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.scenarios import expand_sets
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
        policy: The policy. As in evaluation, `adapt_policy` adapts it to each scenario.
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
    if not whole or not all(map(_is_score, scores)):
        raise ValueError(_damaged(path, "it is cut off or contains something else than scores"))
    return scores


def write_curve(folder: Path, scores: list[Score]) -> None:
    """Replace the file of the scores."""
    lines = io.StringIO(newline="")
    csv.writer(lines).writerows([Score._fields, *scores])
    write_text(folder / CURVE, lines.getvalue())


def check_curve(folder: Path, settings: TrainSettings, steps: int) -> None:
    """Check that the scores of a run before a checkpoint are complete, and that its best policy is there.

    An evaluation is due at the first rollout that starts after a multiple of `eval_freq` timesteps.

    Args:
        folder: The folder of the run.
        settings: The settings of the run.
        steps: Timesteps of the checkpoint.

    Raises:
        ValueError: If one of the files is damaged or missing.
    """
    every, done = settings.eval_freq, [score.steps for score in read_curve(folder) if score.steps <= steps]
    if not every or steps == 0:
        return
    rollout = settings.rollout_timesteps()
    for last, following in zip([None, *done], [*done, steps], strict=True):
        due = 0 if last is None else (last // every + 1) * every
        if following >= due + rollout or (last is not None and following < last):
            raise ValueError(_damaged(folder / CURVE, f"it lacks the evaluation after {due} timesteps"))
    if not (folder / BEST).is_file():
        raise ValueError(_damaged(folder / BEST, "it does not exist"))
    try:
        MlpPolicy.load(folder / BEST)
    except ValueError as error:
        raise ValueError(_damaged(folder / BEST, str(error))) from None


def _is_score(score: Score) -> bool:
    limits = ((0, math.inf), (0.0, math.inf), (0.0, 1.0), (0.0, math.inf))
    return all(math.isfinite(x) and low <= x <= high for x, (low, high) in zip(score, limits, strict=True))


def _damaged(path: Path, reason: str) -> str:
    return f"{path} is damaged: {reason}; restore the file, or train again in another folder"
