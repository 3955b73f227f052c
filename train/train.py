"""Training PPO from Stable-Baselines3 on the native vector environment.

A run folder holds everything that a run is: `settings.json` (resolved), `origin.json` (versions, commit, hardware),
`checkpoint.zip` (the latest), `model.zip` (the end) and TensorBoard's events. Interrupted, a run leaves its checkpoint
and goes on from there.
"""

import json
import signal
import time
from pathlib import Path
from typing import Any

import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from tqdm.auto import tqdm

from train.origin import origin
from train.sb3_vec_env import SB3VecEnv
from train.scenarios import find_scenario
from train.settings import TrainSettings, read_settings, to_mapping

SETTINGS, CHECKPOINT, MODEL = "settings.json", "checkpoint.zip", "model.zip"
_ACTIVATIONS = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh, "elu": torch.nn.ELU}


class _Watch(BaseCallback):
    """Ends training when the time is up, and keeps the latest checkpoint."""

    def __init__(self, settings: TrainSettings, folder: Path) -> None:
        super().__init__()
        self.settings = settings
        self.folder = folder
        self.began = time.perf_counter()
        self.saved_at = 0

    def _on_training_start(self) -> None:
        self.saved_at = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self.saved_at >= self.settings.checkpoint_steps:
            save_checkpoint(self.model, self.folder)
            self.saved_at = self.num_timesteps

    def _on_step(self) -> bool:
        limit = self.settings.max_seconds
        return limit <= 0 or time.perf_counter() - self.began < limit


class _Progress(BaseCallback):
    """A progress bar with the mean length and return of the latest episodes."""

    def __init__(self, total_steps: int) -> None:
        super().__init__()
        self.total_steps = total_steps

    def _on_training_start(self) -> None:
        self.bar = tqdm(total=self.total_steps, initial=self.num_timesteps, unit="step", unit_scale=True)

    def _on_rollout_end(self) -> None:
        if episodes := self.model.ep_info_buffer:
            length = sum(item["l"] for item in episodes) / len(episodes)
            gained = sum(item["r"] for item in episodes) / len(episodes)
            self.bar.set_postfix_str(f"episodes of {length:.0f} steps, return {gained:.0f}", refresh=False)
        self.bar.update(self.num_timesteps - self.bar.n)

    def _on_training_end(self) -> None:
        self.bar.close()

    def _on_step(self) -> bool:
        return True


def save_checkpoint(model: Any, folder: Path) -> None:
    """Replace the checkpoint in `folder`; an interruption in the middle leaves the old one."""
    unfinished = folder / "unfinished.zip"
    model.save(unfinished)
    unfinished.replace(folder / CHECKPOINT)


def make_env(settings: TrainSettings) -> SB3VecEnv:
    """The scenario to train in, as Stable-Baselines3 wants it."""
    env = find_scenario(settings.scenario).make_vec(settings.num_envs, AutoresetMode.SAME_STEP)
    return SB3VecEnv(env, settings.reward_scale)


def make_model(settings: TrainSettings, env: SB3VecEnv, folder: Path | None) -> PPO:
    """An untrained PPO; with a `folder`, TensorBoard's events go there."""
    span = settings.learning_rate - settings.final_learning_rate
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda remaining: settings.final_learning_rate + span * max(remaining, 0.0),
        n_steps=settings.rollout_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.epochs,
        gamma=settings.discount,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy_coefficient,
        policy_kwargs={
            "net_arch": list(settings.hidden),
            "activation_fn": _ACTIVATIONS[settings.activation],
            "log_std_init": settings.initial_log_std,
        },
        tensorboard_log=None if folder is None else str(folder),
        seed=settings.seed,
        device="cpu",
    )


def train(settings: TrainSettings, folder: Path, *, progress: bool = True) -> Path:
    """Train from scratch, or go on from the folder's checkpoint.

    Args:
        settings: of the run; those of a run to go on with are in its folder, see `resume`.
        folder: of the run.
        progress: whether to draw a progress bar.

    Returns:
        The path of the trained model.

    Raises:
        FileExistsError: the folder holds a run already.
    """
    if (folder / SETTINGS).exists():
        raise FileExistsError(f"{folder} holds a run already: resume it, or choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(folder / SETTINGS, to_mapping(settings))
    _write_json(folder / "origin.json", origin())
    return _learn(_fresh_model(settings, folder), settings, folder, progress)


def resume(folder: Path, *, progress: bool = True) -> Path:
    """Go on with an interrupted run from its latest checkpoint, or from the start if it has none yet; as `train`.

    Raises:
        FileNotFoundError: the folder holds no interrupted run.
    """
    if (folder / MODEL).exists():
        raise FileNotFoundError(f"the run in {folder} is finished: there is nothing to resume")
    if not (folder / SETTINGS).exists():
        raise FileNotFoundError(f"{folder} holds no run to go on with")
    settings = read_settings(str(folder / SETTINGS))
    if not (folder / CHECKPOINT).exists():
        return _learn(_fresh_model(settings, folder), settings, folder, progress)
    torch.set_num_threads(settings.threads)
    env = make_env(settings)
    model = PPO.load(folder / CHECKPOINT, env=env, device="cpu")
    env.seed(first_episode(settings) + settings.num_envs + model.num_timesteps)  # episodes not seen before
    return _learn(model, settings, folder, progress)


def first_episode(settings: TrainSettings) -> int:
    """Seed of a run's first row: every run has a block of 2³² seeds, which no other run and no evaluation touches."""
    return (1 + settings.seed) << 32


def _fresh_model(settings: TrainSettings, folder: Path) -> PPO:
    torch.set_num_threads(settings.threads)
    env = make_env(settings)
    model = make_model(settings, env, folder)
    env.seed(first_episode(settings))  # last, since PPO seeds its environment too
    return model


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _learn(model: PPO, settings: TrainSettings, folder: Path, progress: bool) -> Path:
    steps = settings.total_steps - model.num_timesteps
    callbacks: list[BaseCallback] = [_Watch(settings, folder)]
    if progress:
        callbacks.append(_Progress(settings.total_steps))
    terminate = signal.signal(signal.SIGTERM, _interrupt)
    try:
        model.learn(max(steps, 0), CallbackList(callbacks), reset_num_timesteps=False, tb_log_name="events")
    except KeyboardInterrupt:
        save_checkpoint(model, folder)
        print(f"Interrupted after {model.num_timesteps} steps; `quadpend train --resume {folder}` goes on.")
        raise
    finally:
        signal.signal(signal.SIGTERM, terminate)
    model.save(folder / MODEL)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return folder / MODEL


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
