"""Callbacks of a training run: checkpoints, stop conditions, evaluation, TensorBoard and the progress bar."""

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from quadpend_baselines import Policy
from quadpend_train.common.files import atomic, write_text
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.policies.from_sb3 import export
from quadpend_train.training.settings import TrainSettings

CHECKPOINT, CURVE, BEST = "checkpoint.zip", "curve.csv", "best.npz"
DIVERGED = (
    "training diverged within {} steps: the weights of the networks are not finite; lower learning_rate or reward_scale"
)
_CHECK_INTERVAL = 256  # rollouts of SAC and TQC between two checks for divergence


class Score(NamedTuple):
    """One point of the learning curve."""

    steps: int  # timesteps of training before the evaluation
    seconds: float  # duration of training before the evaluation, s
    survival: float  # share of episodes without a fall, that is an early termination
    penalised_rmse: float  # mean over all episodes of the RMSE of the tracking error, m; a fall counts as 1 m


def read_curve(folder: Path) -> list[Score]:
    """Return the scores of all evaluations of a run so far."""
    if not (path := folder / CURVE).is_file():
        return []
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()[1:]]
    return [Score(int(steps), *map(float, numbers)) for steps, *numbers in rows]


def validate(policy: Policy, settings: TrainSettings, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Return survival and penalised RMSE (m) of a policy in the training scenarios of a run, see `Score`.

    They are means over `n_eval_episodes` episodes of each scenario, with different seeds in different scenarios.
    """
    episodes = settings.n_eval_episodes
    results = [
        run_episodes([policy], scenario, episodes, seed + number * episodes)
        for number, scenario in enumerate(settings.scenarios)
    ]
    survived = np.concatenate([result.survived for result in results], axis=1)
    rmse = np.concatenate([result.penalised_rmse for result in results], axis=1)
    return float(survived.mean()), float(rmse.mean())


def first_seed(settings: TrainSettings) -> int:
    """Return the seed of the first sub-environment of a run.

    Runs with different `seed` use disjoint blocks of 2³² seeds. No evaluation uses these seeds.
    """
    return (1 + settings.seed) << 32


def save_checkpoint(model: Any, folder: Path) -> None:
    """Replace the checkpoint in `folder`. If saving is interrupted, the old checkpoint stays valid."""
    buffer = f"buffer_{model.num_timesteps}.pkl"
    with ExitStack() as replaced:  # the last one first: the checkpoint refers to its buffer
        checkpoint = replaced.enter_context(atomic(folder / CHECKPOINT))
        if getattr(model, "replay_buffer", None) is not None:
            model.save_replay_buffer(replaced.enter_context(atomic(folder / buffer)))
        model.save(checkpoint)
    for old in folder.glob("buffer_*.pkl"):
        if old.name != buffer:
            old.unlink()


class RolloutCallback(BaseCallback):
    """A callback that does nothing at a step."""

    def _on_step(self) -> bool:
        return True


class Checkpoints(RolloutCallback):
    """Save a checkpoint every `save_freq` steps."""

    def __init__(self, settings: TrainSettings, folder: Path) -> None:
        super().__init__()
        self.settings, self.folder = settings, folder

    def _on_training_start(self) -> None:
        self.saved = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self.saved >= self.settings.save_freq:
            save_checkpoint(self.model, self.folder)
            self.saved = self.num_timesteps


class StopConditions(RolloutCallback):
    """Stop training for `max_seconds` or if it diverges, and freeze PPO's actor during the warm-up of the critic."""

    def __init__(self, settings: TrainSettings, end: float) -> None:
        super().__init__()
        self.settings, self.end = settings, end  # a time of `time.perf_counter`
        self.time_is_up, self.rollouts = False, 0

    def _on_rollout_start(self) -> None:
        self.rollouts += 1
        if not hasattr(self.model, "replay_buffer") or self.rollouts % _CHECK_INTERVAL == 0:
            self.check_finite()
        if warmup := self.settings.critic_warmup_steps:
            for name, parameter in self.model.policy.named_parameters():
                parameter.requires_grad_("value" in name or self.num_timesteps >= warmup)

    def check_finite(self) -> None:
        """Raise FloatingPointError if a weight is not finite."""
        if not all(torch.isfinite(parameter).all() for parameter in self.model.policy.parameters()):
            raise FloatingPointError(DIVERGED.format(self.num_timesteps))

    def _on_step(self) -> bool:
        self.time_is_up = time.perf_counter() >= self.end
        return not self.time_is_up


class EvaluationCallback(RolloutCallback):
    """Evaluate the policy every `eval_freq` steps, and save the best one.

    ``curve.csv`` has one line per evaluation, see `Score`. The time of the evaluations does not count as training time.
    A resumed run continues the curve: it evaluates again after the timesteps of the last line.
    """

    def __init__(self, settings: TrainSettings, folder: Path) -> None:
        super().__init__()
        self.settings, self.folder = settings, folder
        self.scores: list[Score] = []
        self.begin = time.perf_counter()  # later by the time of the evaluations, earlier by that before a resumed run

    def _on_training_start(self) -> None:
        self.scores = read_curve(self.folder)
        self.begin = time.perf_counter() - (self.scores[-1].seconds if self.scores else 0.0)

    def _on_rollout_start(self) -> None:
        every = self.settings.eval_freq
        if every and self.num_timesteps >= (self.scores[-1].steps // every + 1 if self.scores else 0) * every:
            self.evaluate()

    def _on_training_end(self) -> None:
        if self.settings.eval_freq and (not self.scores or self.scores[-1].steps < self.num_timesteps):
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the current policy, and record its score."""
        start = time.perf_counter()
        policy = export(self.model, **self.settings.policy_interface())
        survival, rmse = validate(policy, self.settings)
        score = Score(self.num_timesteps, round(start - self.begin, 2), survival, rmse)
        if rmse < min((other.penalised_rmse for other in self.scores), default=float("inf")):
            policy.save(self.folder / BEST)
        self.scores.append(score)
        lines = (",".join(map(str, line)) for line in (Score._fields, *self.scores))
        write_text(self.folder / CURVE, "\n".join(lines) + "\n")
        for name in ("seconds", "survival", "penalised_rmse"):
            self.logger.record(f"evaluation/{name}", getattr(score, name))
        self.begin += time.perf_counter() - start


class Report(RolloutCallback):
    """Show the latest episodes and score on a progress bar, and log reward terms and tracking error (m)."""

    def __init__(self, bar: Any, scores: EvaluationCallback) -> None:
        super().__init__()
        self.bar, self.evaluation = bar, scores

    def _on_rollout_end(self) -> None:
        env: Any = self.model.get_env()
        for name, value in env.take_means().items():
            self.logger.record_mean(f"reward/{name}", value)
        if self.num_timesteps - self.bar.n < 1000:
            return
        parts = []
        if episodes := self.model.ep_info_buffer:
            means = (sum(item[key] for item in episodes) / len(episodes) for key in "lr")
            parts.append("episodes of {:.0f} actions, return {:.0f}".format(*means))
        if self.evaluation.scores:
            parts.append(f"penalised RMSE {1e3 * self.evaluation.scores[-1].penalised_rmse:.0f} mm")
        self.bar.set_postfix_str(", ".join(parts), refresh=False)
        self.bar.update(self.num_timesteps - self.bar.n)
