"""What happens beside learning: legs and checkpoints, evaluation, early stop, TensorBoard, the progress bar."""

import csv
import time
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from tqdm.auto import tqdm

from quadpend_train.policies.export import export
from quadpend_train.training.environment import make_env, scenarios_at
from quadpend_train.training.settings import TrainSettings
from quadpend_train.training.validation import Score, validate

CURVE, BEST = "curve.csv", "best.npz"
DIVERGED = (
    "training diverged within {} steps: the networks hold numbers that are not finite; lower learning_rate or"
    " reward_scale"
)
_CHECKED = 256  # calls between two looks at the weights, where a rollout is a single step


def first_episode(settings: TrainSettings) -> int:
    """Seed of a run's first row: every run has a block of 2³² seeds, which no other run and no evaluation touches."""
    return (1 + settings.seed) << 32


def save_checkpoint(model: Any, folder: Path) -> None:
    """Replace the checkpoint in `folder`; an interruption in the middle leaves the old one."""
    parts = {"checkpoint.zip": model.save}
    buffer = f"buffer_{model.num_timesteps}.pkl"
    if getattr(model, "replay_buffer", None) is not None:
        parts = {buffer: model.save_replay_buffer, **parts}
    for name, save in parts.items():
        save(folder / f"unfinished_{name}")
    for name in parts:
        (folder / f"unfinished_{name}").replace(folder / name)
    for old in folder.glob("buffer_*.pkl"):
        if old.name != buffer:
            old.unlink()


class CheckpointSegments(BaseCallback):
    """Divides a run into legs, each of which depends on the settings and the model it begins with only.

    A leg begins with new episodes and new random numbers, and a checkpoint is what it begins with: so a run that was
    interrupted and goes on is the run that was not.
    """

    def __init__(self, settings: TrainSettings, folder: Path) -> None:
        super().__init__()
        self.settings, self.folder = settings, folder
        self.began_at = -1

    def _on_rollout_start(self) -> None:
        steps, settings = self.num_timesteps, self.settings
        same = self.began_at < 0 or scenarios_at(settings, steps) == scenarios_at(settings, self.began_at)
        if self.began_at >= 0 and steps - self.began_at < settings.save_freq and same:
            return
        if self.began_at >= 0:
            save_checkpoint(self.model, self.folder)
        self.began_at = steps
        self._begin()

    def _begin(self) -> None:
        model: Any = self.model
        steps, settings = self.num_timesteps, self.settings
        env = model.get_env()
        if settings.curriculum:
            env.env = make_env(settings, steps).env
        model.set_random_seed((settings.seed * 1_000_003 + steps) % 2**32)
        env.seed(first_episode(settings) + steps)
        model._last_obs = env.reset()
        model._last_episode_starts[:] = True
        if model.use_sde:
            (model.policy if settings.algo == "ppo" else model.actor).reset_noise(env.num_envs)

    def _on_step(self) -> bool:
        return True


class StopConditions(BaseCallback):
    """Ends training when the time is up, and says so when it has diverged; PPO's critic may learn alone at first."""

    def __init__(self, settings: TrainSettings) -> None:
        super().__init__()
        self.settings = settings
        self.began = time.perf_counter()
        self.calls = 0

    def _on_rollout_start(self) -> None:
        self.calls += 1
        if self.settings.algo == "ppo" or self.calls % _CHECKED == 0:
            self.check()
        if critic := self.settings.ppo.critic_warmup_steps if self.settings.algo == "ppo" else 0:
            for name, parameter in self.model.policy.named_parameters():
                parameter.requires_grad_("value" in name or self.num_timesteps >= critic)

    def check(self) -> None:
        """Raise FloatingPointError if a weight is no number any more."""
        if not all(torch.isfinite(parameter).all() for parameter in self.model.policy.parameters()):
            raise FloatingPointError(DIVERGED.format(self.num_timesteps))

    def _on_step(self) -> bool:
        limit = self.settings.max_seconds
        return limit <= 0 or time.perf_counter() - self.began < limit


class EvaluationCallback(BaseCallback):
    """Flies the training scenarios now and then, keeps the best policy, and ends a run that gets no better.

    ``curve.csv`` has a line for each evaluation; `seconds` are of training, without the evaluations.
    """

    def __init__(self, settings: TrainSettings, folder: Path, target: float | None = None) -> None:
        super().__init__()
        self.settings, self.folder, self.target = settings, folder, target
        self.scores: list[Score] = []
        self.flown = 0.0
        self.stop = False

    def _on_training_start(self) -> None:
        self.began = time.perf_counter()
        self.scores = [score for score in read_curve(self.folder) if score.steps < self.num_timesteps]
        self.before = self.scores[-1].seconds if self.scores else 0.0

    def _on_rollout_start(self) -> None:
        every = self.settings.eval_freq
        if every and self.num_timesteps >= len(self.scores) * every:
            self.evaluate()

    def _on_training_end(self) -> None:
        if self.settings.eval_freq and (not self.scores or self.scores[-1].steps < self.num_timesteps):
            self.evaluate()

    def evaluate(self) -> None:
        """Fly, and write down how well."""
        paused = time.perf_counter()
        policy = export(self.model, **self.settings.policy_interface())
        survival, rmse = validate(policy, self.settings)
        seconds = self.before + paused - self.began - self.flown
        score = Score(self.num_timesteps, round(seconds, 2), survival, rmse)
        if rmse < min((other.penalised_rmse for other in self.scores), default=float("inf")):
            policy.save(self.folder / BEST)
        self.scores.append(score)
        _write_curve(self.folder, self.scores)
        for name, value in score._asdict().items():
            if name != "steps":
                self.logger.record(f"evaluation/{name}", value)
        best = min(range(len(self.scores)), key=lambda i: self.scores[i].penalised_rmse)
        patience = self.settings.patience
        self.stop |= bool(patience) and len(self.scores) - 1 - best >= patience
        self.flown += time.perf_counter() - paused

    def _on_step(self) -> bool:
        return not self.stop


class RewardTerms(BaseCallback):
    """The means of the reward's terms and of the tracking error, for TensorBoard."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        env: Any = self.model.get_env()
        for name, value in env.take_means().items():
            self.logger.record_mean(f"reward/{name}", value)


class ProgressBar(BaseCallback):
    """A progress bar with the mean length and return of the latest episodes, and the latest score."""

    def __init__(self, settings: TrainSettings, evaluate: EvaluationCallback) -> None:
        super().__init__()
        self.settings, self.scores = settings, evaluate

    def _on_training_start(self) -> None:
        total = self.settings.total_timesteps
        self.bar = tqdm(total=total, initial=self.num_timesteps, unit="step", unit_scale=True, mininterval=0.5)

    def _on_rollout_end(self) -> None:
        if self.num_timesteps - self.bar.n < 1000:
            return
        told = list(scenarios_at(self.settings, self.num_timesteps)) if self.settings.curriculum else []
        if episodes := self.model.ep_info_buffer:
            told.append(f"episodes of {sum(item['l'] for item in episodes) / len(episodes):.0f} steps")
            told.append(f"return {sum(item['r'] for item in episodes) / len(episodes):.0f}")
        if self.scores.scores:
            told.append(f"penalised RMSE {1e3 * self.scores.scores[-1].penalised_rmse:.0f} mm")
        self.bar.set_postfix_str(", ".join(told), refresh=False)
        self.bar.update(self.num_timesteps - self.bar.n)

    def _on_training_end(self) -> None:
        self.bar.update(self.num_timesteps - self.bar.n)
        self.bar.close()

    def _on_step(self) -> bool:
        return True


def read_curve(folder: Path) -> list[Score]:
    """The evaluations of a run so far."""
    path = folder / CURVE
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [Score(int(row["steps"]), *(float(row[name]) for name in Score._fields[1:])) for row in rows]


def _write_curve(folder: Path, scores: list[Score]) -> None:
    with (folder / CURVE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerows([Score._fields, *scores])
