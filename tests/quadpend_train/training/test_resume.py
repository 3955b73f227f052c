"""A run that was interrupted and goes on is the run that was not, to the bit."""

import csv
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.training import callbacks
from quadpend_train.training import train as training
from quadpend_train.training.settings import HybridSettings, PpoSettings, TrainSettings
from tests.helpers.envs import assert_same
from tests.helpers.training import BRIEF, BRIEF_SAC, OTHER, SHORT, interrupt_at, model_of, numbers_of, trained

LEGS = replace(BRIEF, save_freq=512)  # a leg is two rollouts
LEGS_SAC = replace(BRIEF_SAC, save_freq=128)
RESIDUAL = HybridSettings("adrc-matched", "residual_action", action_scale=0.3)
RUNS: dict[str, TrainSettings] = {
    "ppo": LEGS,
    "ppo, curriculum": replace(LEGS, curriculum=(OTHER, SHORT), curriculum_steps=512, save_freq=256),
    "ppo, residual action": replace(LEGS, hybrid=RESIDUAL),
    "ppo, bandwidth scheduling": replace(LEGS, hybrid=HybridSettings("flatness", "bandwidth_scheduling")),
    "ppo, history": replace(LEGS, history=2, history_actions=1),
    "ppo, gSDE": replace(LEGS, sde_sample_freq=4),
    "ppo, evaluated": replace(LEGS, eval_freq=256, save_freq=256),
    "ppo, mixed": replace(LEGS, scenario=(SHORT, OTHER)),
    "ppo, critic first": replace(LEGS, ppo=replace(LEGS.ppo, critic_warmup_steps=700), save_freq=256),
    "ppo, imitation": replace(LEGS, hybrid=HybridSettings("adrc-matched", imitation_timesteps=320)),
    "ppo, long rollouts": replace(LEGS, ppo=PpoSettings(n_steps=24, n_epochs=2), total_timesteps=1200),
    "ppo, baseline-relative and repeated": replace(
        LEGS, hybrid=replace(RESIDUAL, baseline_relative_reward=True, failure_penalty=2.0, action_repeat=4)
    ),
    "sac": LEGS_SAC,
    "sac, gSDE": replace(LEGS_SAC, sde_sample_freq=4),
    "sac, residual action, evaluated, curriculum": replace(
        LEGS_SAC, hybrid=RESIDUAL, eval_freq=128, curriculum=(OTHER,), curriculum_steps=256
    ),
    "tqc": replace(LEGS_SAC, algo="tqc"),
}
every_run = pytest.mark.parametrize("settings", RUNS.values(), ids=RUNS.keys())


def curve(folder: Path) -> list[list[str]]:
    """What is written of the evaluations, but for the time they took."""
    if not (folder / "curve.csv").exists():
        return []
    with (folder / "curve.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["steps", "seconds", "survival", "penalised_rmse"]
    return [[row[0], *row[2:]] for row in rows]


@every_run
def test_an_interrupted_run_that_goes_on_is_one_that_was_not_interrupted(
    settings: TrainSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of a leg, just after a checkpoint, and before the first of them."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    policy = trained(settings, whole)
    rows = settings.num_envs
    rollout = rows * (settings.ppo.n_steps if settings.algo == "ppo" else 1)
    leg = rollout * -(-settings.save_freq // rollout)
    stops = [leg // 2, leg + leg // 2 + rows, 2 * leg + rows] if 2 * leg < settings.total_timesteps else [leg + rows]
    for number, steps in enumerate(stops):
        with monkeypatch.context() as patch:
            interrupt_at(steps, patch)
            with pytest.raises(KeyboardInterrupt):
                training.resume(broken, progress=False) if number else trained(settings, broken)
    assert (broken / "checkpoint.zip").exists()
    resumed = MlpPolicy.load(training.resume(broken, progress=False))
    assert weight_difference(policy, resumed) == 0.0
    assert_same(numbers_of(model_of(broken, settings)), numbers_of(model_of(whole, settings)))
    assert model_of(broken, settings).num_timesteps == model_of(whole, settings).num_timesteps
    assert curve(broken) == curve(whole)
    assert bool(curve(whole)) == bool(settings.eval_freq)
    assert resumed.card["score"] == policy.card["score"]
    if settings.eval_freq:
        best = [MlpPolicy.load(folder / "best.npz") for folder in (broken, whole)]
        assert weight_difference(*best) == 0.0
    for folder in (broken, whole):
        assert not list(folder.glob("checkpoint*")) + list(folder.glob("buffer*")) + list(folder.glob("unfinished*"))


def test_checkpoints_are_kept_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []
    monkeypatch.setattr(callbacks, "save_checkpoint", lambda model, folder: kept.append(model.num_timesteps))
    trained(replace(BRIEF, save_freq=512, total_timesteps=2048), tmp_path)
    assert kept == [512, 1024, 1536]


def test_a_checkpoint_is_where_an_interrupted_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        interrupt_at(800, patch)
        with pytest.raises(KeyboardInterrupt):
            trained(LEGS, tmp_path)
    assert f"Interrupted after 800 steps; `quadpend train --resume {tmp_path}` goes on." in capsys.readouterr().out
    assert PPO.load(tmp_path / "checkpoint.zip", device="cpu").num_timesteps == 512
    training.resume(tmp_path, progress=False)
    with pytest.raises(FileNotFoundError, match="is finished: there is nothing to go on with"):
        training.resume(tmp_path)


@pytest.mark.parametrize("after", [0, 1, 2, 3])
def test_an_interruption_while_a_checkpoint_is_saved_leaves_the_old_one(
    after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Model and buffer together: it goes on as if it had not begun to save, or as if it had saved."""
    settings = replace(LEGS_SAC, total_timesteps=384)
    policy = trained(settings, tmp_path / "whole")
    broken = tmp_path / "broken"
    save, rename = callbacks.save_checkpoint, Path.replace

    def broken_off(model: Any, folder: Path) -> None:
        if model.num_timesteps < 256:
            return save(model, folder)
        done = 0

        def counted(call: Any) -> Any:
            def once(*arguments: Any, **more: Any) -> Any:
                nonlocal done
                if done == after:
                    raise KeyboardInterrupt
                done += 1
                return call(*arguments, **more)

            return once

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", counted(rename))
            for name in ("save", "save_replay_buffer"):
                patch.setattr(type(model), name, counted(getattr(type(model), name)))
            return save(model, folder)

    with monkeypatch.context() as patch:
        patch.setattr(callbacks, "save_checkpoint", broken_off)
        with pytest.raises(KeyboardInterrupt):
            trained(settings, broken)
    assert weight_difference(MlpPolicy.load(training.resume(broken, progress=False)), policy) == 0.0


def test_a_run_that_is_terminated_is_interrupted(tmp_path: Path) -> None:
    """By a signal, as of a batch system; what a signal did before is restored."""

    class Terminated(BaseCallback):
        def _on_step(self) -> bool:
            if self.num_timesteps >= 700:
                os.kill(os.getpid(), signal.SIGTERM)
            return True

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        trained(LEGS, tmp_path, more=[Terminated()])
    assert signal.getsignal(signal.SIGTERM) is before
    assert (tmp_path / "checkpoint.zip").exists()
    training.resume(tmp_path, progress=False)


def test_a_run_that_died_before_its_first_checkpoint_begins_again(tmp_path: Path) -> None:
    policy = trained(BRIEF, tmp_path / "whole")
    dead = tmp_path / "dead"
    dead.mkdir()
    for name in ("settings.json", "origin.json"):
        (dead / name).write_text((tmp_path / "whole" / name).read_text())
    assert weight_difference(MlpPolicy.load(training.resume(dead, progress=False)), policy) == 0.0


def test_a_folder_with_a_run_is_not_overwritten(tmp_path: Path) -> None:
    trained(BRIEF, tmp_path)
    with pytest.raises(FileExistsError, match="holds a run already: resume it, or choose another folder"):
        trained(BRIEF, tmp_path)
    with pytest.raises(FileNotFoundError, match="holds no run"):
        training.resume(tmp_path / "nowhere")
