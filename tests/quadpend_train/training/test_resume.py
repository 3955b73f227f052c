"""A resumed run gives bit for bit the policy of an uninterrupted run."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from stable_baselines3 import PPO

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.training import train as training
from quadpend_train.training.settings import ApgSettings, HybridSettings, TrainSettings
from quadpend_train.training.train import locked
from tests.helpers.envs import assert_same
from tests.helpers.training import (
    BRIEF,
    BRIEF_SAC,
    OTHER,
    SHORT,
    interrupt_at,
    model_of,
    read_curve,
    train_policy,
    trained_arrays,
    with_arguments,
)

SEGMENTS = replace(BRIEF, save_freq=512)  # a segment has two rollouts
SEGMENTS_SAC = replace(BRIEF_SAC, save_freq=128)
RESIDUAL = HybridSettings("adrc-matched", "residual_action", action_scale=0.3)
LAGGED = json.dumps({"wind": "windy", "actuators": [{"kind": "action_delay"}, {"kind": "motor_lag"}]})
MIXED = replace(SEGMENTS, scenarios=(SHORT, OTHER), eval_freq=256, save_freq=256)
INPUTS = replace(SEGMENTS, input_scales=(8.0,), critic_warmup_steps=700, save_freq=256)
GSDE_SAC = with_arguments(SEGMENTS_SAC, use_sde=True, sde_sample_freq=4, train_freq=4)
RELATIVE = replace(RESIDUAL, baseline_relative_reward=True, failure_penalty=2.0)
RUNS: dict[str, TrainSettings] = {
    "ppo, evaluated": MIXED,
    "ppo, input scales, critic first": INPUTS,
    "ppo, gSDE": with_arguments(SEGMENTS, use_sde=True, sde_sample_freq=4),
    "ppo, baseline-relative": replace(SEGMENTS, hybrid=RELATIVE),
    "ppo, imitation": replace(SEGMENTS, hybrid=HybridSettings("adrc-matched", imitation_timesteps=320)),
    "ppo, long rollouts": replace(with_arguments(SEGMENTS, n_steps=24, n_epochs=2), total_timesteps=1200),
    "sac, gSDE": GSDE_SAC,
    "tqc, residual action, evaluated": replace(SEGMENTS_SAC, algo="tqc", hybrid=RESIDUAL, eval_freq=128),
    "apg, mixed": replace(
        SEGMENTS,
        algo="apg",
        scenarios=(SHORT, LAGGED),
        hybrid=HybridSettings("flatness", situation=True),
        arguments={},
        apg=ApgSettings(window=8),
        eval_freq=256,
    ),
}


@pytest.mark.parametrize("settings", RUNS.values(), ids=RUNS.keys())
def test_resumed_run_equals_an_uninterrupted_run(
    settings: TrainSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After interruptions in the middle of a segment, just after a checkpoint, and before the first checkpoint."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    policy = train_policy(settings, whole)
    rows = settings.num_envs
    rollout = rows * (8 if settings.algo == "apg" else settings.argument("n_steps") or 1)
    segment = rollout * -(-settings.save_freq // rollout)
    stops = (
        [segment // 2, segment + segment // 2 + rows, 2 * segment + rows]
        if 2 * segment < settings.total_timesteps
        else [segment + rows]
    )
    for number, steps in enumerate(stops):
        with monkeypatch.context() as patch:
            interrupt_at(steps, patch)
            with pytest.raises(KeyboardInterrupt):
                training.resume(broken, progress=False) if number else train_policy(settings, broken)
    assert (broken / "checkpoint.zip").exists()
    for name in ("curve.csv", "best.npz"):  # scores and best policy come from the checkpoint
        (broken / name).unlink(missing_ok=True)
    resumed = MlpPolicy.load(training.resume(broken, progress=False))
    assert weight_difference(policy, resumed) == 0.0
    assert_same(trained_arrays(model_of(broken, settings)), trained_arrays(model_of(whole, settings)))
    assert model_of(broken, settings).num_timesteps == model_of(whole, settings).num_timesteps
    curves = [[score._replace(seconds=0.0) for score in read_curve(folder)] for folder in (broken, whole)]
    assert curves[0] == curves[1]
    assert bool(curves[0]) == bool(settings.eval_freq)
    assert resumed.card["score"] == policy.card["score"]
    if settings.eval_freq:
        best = [MlpPolicy.load(folder / "best.npz") for folder in (broken, whole)]
        assert weight_difference(*best) == 0.0
    for folder in (broken, whole):
        assert not list(folder.glob("checkpoint*")) + list(folder.glob("buffer*")) + list(folder.glob("unfinished*"))


def test_interrupted_run_resumes_from_its_latest_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        interrupt_at(800, patch)
        with pytest.raises(KeyboardInterrupt, match=f"`quadpend train --resume {tmp_path}` continues the run"):
            train_policy(SEGMENTS, tmp_path)
    assert PPO.load(tmp_path / "checkpoint.zip", device="cpu").num_timesteps == 512
    training.resume(tmp_path, progress=False)
    with pytest.raises(FileNotFoundError, match="is finished: there is nothing to resume"):
        training.resume(tmp_path)
    with pytest.raises(FileExistsError, match="contains a run already: resume it, or choose another folder"):
        train_policy(SEGMENTS, tmp_path)
    with pytest.raises(FileNotFoundError, match="contains no run"):
        training.resume(tmp_path / "nowhere")


@pytest.mark.parametrize("after", [0, 1])
def test_a_checkpoint_that_was_interrupted_is_the_old_one(
    after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Model and replay buffer belong together: both are from the old checkpoint or both from the new one."""
    settings, number, rename = replace(SEGMENTS_SAC, total_timesteps=384), -2 - after, Path.replace
    policy = train_policy(settings, tmp_path / "whole")

    def interrupted(self: Path, target: Path) -> Path:
        nonlocal number
        number += target.name.startswith(("checkpoint", "buffer"))
        if number == 1:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train_policy(settings, tmp_path / "broken")
    assert weight_difference(MlpPolicy.load(training.resume(tmp_path / "broken", progress=False)), policy) == 0.0


def test_a_second_process_in_a_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lock of a process that was killed does not stay."""
    code = (
        "import sys, time; from pathlib import Path; from quadpend_train.training.train import locked\n"
        "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(SystemExit, match="2"):
            main(["train", "--total-timesteps", "256", "--out", str(tmp_path)])
        assert f"another process trains in {tmp_path}" in capsys.readouterr().err
        process.kill()
    with locked(tmp_path):
        pass
