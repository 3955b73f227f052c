"""A run folder holds one run of one process; its files are complete."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.training import train as training
from quadpend_train.training.run_folder import locked
from quadpend_train.training.validation import read_curve
from tests.helpers.bad_input import assert_refused
from tests.helpers.training import BRIEF, interrupt_at, train_policy

EVALUATED = replace(BRIEF, eval_freq=256, save_freq=512)


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was interrupted after 800 steps; its checkpoint is that after 512 steps."""
    folder = tmp_path_factory.mktemp("interrupted")
    with pytest.MonkeyPatch.context() as patch:
        interrupt_at(800, patch)
        with pytest.raises(KeyboardInterrupt):
            train_policy(EVALUATED, folder)
    return folder


def test_a_run_exists_from_its_settings_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a killed process wrote before them, the same command replaces."""
    with monkeypatch.context() as patch:
        patch.setattr(training, "to_mapping", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            train_policy(BRIEF, tmp_path / "run")
    assert_refused(lambda: training.resume(tmp_path / "run"), "contains no run", FileNotFoundError)
    again, expected = train_policy(BRIEF, tmp_path / "run"), train_policy(BRIEF, tmp_path / "other")
    assert weight_difference(again, expected) == 0.0


def test_scores_and_best_policy_come_from_the_checkpoint(interrupted: Path, tmp_path: Path) -> None:
    """Damage of their files does not matter."""
    whole = train_policy(EVALUATED, tmp_path / "whole")
    (interrupted / "curve.csv").write_bytes(b"")
    (interrupted / "best.npz").unlink()
    resumed = MlpPolicy.load(training.resume(interrupted, progress=False))
    assert weight_difference(resumed, whole) == 0.0
    curves = [[score._replace(seconds=0.0) for score in read_curve(run)] for run in (interrupted, tmp_path / "whole")]
    assert curves[0] == curves[1]
    assert "command" in json.loads((interrupted / "provenance.json").read_text())


def test_a_second_process_in_a_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lock of a process that was killed does not stay."""
    code = (
        "import sys, time; from pathlib import Path; from quadpend_train.training.run_folder import locked\n"
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


def test_resume_warns_that_loading_executes_code(interrupted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["train", "--resume", str(interrupted), "--seed", "9"])
    assert "executes code that they contain: resume only runs that you trust" in capsys.readouterr().out
