"""An interrupted run resumes from its latest checkpoint."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import train as training
from quadpend_train.training.callbacks import read_curve
from quadpend_train.training.settings import ApgSettings, HybridSettings, TrainSettings
from quadpend_train.training.train import locked
from tests.helpers.training import BRIEF, BRIEF_SAC, interrupt_at, model_of, train_policy

PPO = replace(BRIEF, save_freq=512, eval_freq=256, hybrid=HybridSettings("flatness", imitation_timesteps=320))
SAC = replace(BRIEF_SAC, save_freq=128)
APG = replace(PPO, algo="apg", arguments={}, apg=ApgSettings(window=8))
RUNS = {"ppo": PPO, "sac": SAC, "apg": APG}


@pytest.mark.parametrize("settings", RUNS.values(), ids=RUNS.keys())
def test_an_interrupted_run_resumes_from_its_latest_checkpoint(
    settings: TrainSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        interrupt_at(settings.save_freq + 256, patch)
        with pytest.raises(KeyboardInterrupt, match=f"`quadpend train --resume {tmp_path}` continues the run"):
            train_policy(settings, tmp_path)
    before = read_curve(tmp_path)
    with monkeypatch.context() as patch:
        interrupt_at(0, patch)
        with pytest.raises(KeyboardInterrupt):
            training.resume(tmp_path, progress=False)
    policy = MlpPolicy.load(training.resume(tmp_path, progress=False))
    assert policy.card["steps"] == model_of(tmp_path, settings).num_timesteps == settings.total_timesteps
    curve = read_curve(tmp_path)
    assert curve[: len(before)] == before
    assert [score.steps for score in curve] == ([0, 256, 512, 768, 1024] if settings.eval_freq else [])
    assert not list(tmp_path.glob("checkpoint*")) + list(tmp_path.glob("buffer*")) + list(tmp_path.glob("unfinished*"))
    with pytest.raises(FileNotFoundError, match="is finished: there is nothing to resume"):
        training.resume(tmp_path)
    with pytest.raises(FileExistsError, match="contains a run already: resume it, or choose another folder"):
        train_policy(settings, tmp_path)
    with pytest.raises(FileNotFoundError, match="contains no run"):
        training.resume(tmp_path / "nowhere")


@pytest.mark.parametrize("after", [0, 1])
def test_a_checkpoint_that_was_interrupted_is_the_old_one(
    after: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Model and replay buffer belong together: both are from the old checkpoint or both from the new one."""
    settings, number, rename = replace(SAC, total_timesteps=384), -2 - after, Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        nonlocal number
        number += target.name.startswith(("checkpoint", "buffer"))
        if number == 1:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train_policy(settings, tmp_path)
    assert MlpPolicy.load(training.resume(tmp_path, progress=False)).card["steps"] == 384


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
