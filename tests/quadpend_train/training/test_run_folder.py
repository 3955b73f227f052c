"""A run folder holds one run of one process; its files are complete, and damaged ones are refused by their name."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from quadpend_train.cli.main import main
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.training import run_folder
from quadpend_train.training import train as training
from quadpend_train.training.run_folder import locked
from quadpend_train.training.validation import Score, read_curve, write_curve
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import mlp_policy
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


def copied(folder: Path, target: Path) -> Path:
    target.mkdir()
    for name in ("settings.json", "provenance.json", "checkpoint.zip", "curve.csv", "best.npz"):
        (target / name).write_bytes((folder / name).read_bytes())
    return target


def test_run_without_provenance_resumes(tmp_path: Path) -> None:
    """A process that was killed between the two files left such a folder."""
    policy = train_policy(BRIEF, tmp_path / "whole")
    killed = tmp_path / "killed"
    killed.mkdir()
    (killed / "settings.json").write_bytes((tmp_path / "whole/settings.json").read_bytes())
    resumed = MlpPolicy.load(training.resume(killed, progress=False))
    assert weight_difference(resumed, policy) == 0.0
    assert resumed.card["provenance"]["packages"] == policy.card["provenance"]["packages"]


def test_run_exists_from_its_settings_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a killed process wrote before them, the same command replaces, also with another policy as the start."""
    starts = [tmp_path / f"{seed}.npz" for seed in range(2)]
    for seed, start in enumerate(starts):
        mlp_policy(36, seed=seed).save(start)
    settings = [replace(BRIEF, net_arch=(8, 6), start_from=str(start)) for start in starts]
    with monkeypatch.context() as patch:
        patch.setattr(training, "to_mapping", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            train_policy(settings[0], tmp_path / "run")
    assert {path.name for path in (tmp_path / "run").iterdir()} == {".lock", "start.npz", "provenance.json"}
    assert_refused(lambda: training.resume(tmp_path / "run"), "contains no run", FileNotFoundError)
    (tmp_path / "run/unfinished_1_checkpoint.zip").write_bytes(b"half")
    again, expected = train_policy(settings[1], tmp_path / "run"), train_policy(settings[1], tmp_path / "other")
    assert weight_difference(again, expected) == 0.0
    assert weight_difference(MlpPolicy.load(tmp_path / "run/start.npz"), MlpPolicy.load(starts[1])) == 0.0
    assert not list((tmp_path / "run").glob("unfinished*"))


def test_finished_run_loses_the_checkpoint_that_a_killed_process_left(tmp_path: Path) -> None:
    train_policy(BRIEF, tmp_path)
    for name in ("checkpoint.zip", "buffer_512.pkl"):
        (tmp_path / name).write_bytes(b"")
    assert_refused(lambda: training.resume(tmp_path), "is finished: there is nothing to resume", FileNotFoundError)
    assert not list(tmp_path.glob("checkpoint*")) + list(tmp_path.glob("buffer*"))


def test_continuation_that_was_killed_is_recorded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train_policy(BRIEF, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(training, "to_mapping", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            training.extend(tmp_path, 256, progress=False)
    policy = MlpPolicy.load(training.extend(tmp_path, 256, progress=False))
    assert policy.card["provenance"]["continued_at"] == [1024]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: "", "it is cut off or contains something else than scores"),
        (lambda text: text[: text.index("\n") + 1], "it lacks the evaluation after 0 timesteps"),
        (lambda text: text[:-4], "it is cut off"),
        (lambda text: text[: text.index("256")], "it lacks the evaluation after 256 timesteps"),
        (lambda text: text.replace("256,", "2x6,"), "something else than scores"),
        (lambda text: text.replace("256,", "256,nan,"), "something else than scores"),
        (lambda text: text.replace("survival", "\x00"), "something else than scores"),
        (None, "it lacks the evaluation after 0 timesteps"),
    ],
    ids=["emptied", "only the head", "cut in a line", "cut between lines", "no number", "nan", "other head", "deleted"],
)
def test_damaged_curve_is_refused_by_its_name(damage: object, message: str, interrupted: Path, tmp_path: Path) -> None:
    folder = copied(interrupted, tmp_path / "run")
    text = (folder / "curve.csv").read_bytes().decode()
    if callable(damage):
        (folder / "curve.csv").write_bytes(damage(text).encode())
    else:
        (folder / "curve.csv").unlink()
    assert_refused(lambda: training.resume(folder, progress=False), f"run/curve.csv is damaged: .*{message}")
    assert not (folder / "policy.npz").exists()


def test_missing_best_policy_is_refused_by_its_name(interrupted: Path, tmp_path: Path) -> None:
    folder = copied(interrupted, tmp_path / "run")
    (folder / "best.npz").unlink()
    assert_refused(lambda: training.resume(folder, progress=False), "run/best.npz is damaged: it does not exist")


def test_damaged_best_policy_is_refused_by_its_name(interrupted: Path, tmp_path: Path) -> None:
    folder = copied(interrupted, tmp_path / "run")
    (folder / "best.npz").write_bytes((folder / "best.npz").read_bytes()[:100])
    assert_refused(lambda: training.resume(folder, progress=False), "run/best.npz is damaged: .* is not a policy file")


def test_interrupted_writing_leaves_the_curve_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = [Score(0, 0.0, 0.5, 0.25), Score(64, 1.5, 1.0, 0.125)]
    write_curve(tmp_path, scores[:1])
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_curve(tmp_path, scores)
    assert read_curve(tmp_path) == scores[:1]
    write_curve(tmp_path, scores)
    assert read_curve(tmp_path) == scores
    assert [path.name for path in tmp_path.iterdir()] == ["curve.csv"]


def test_second_process_in_a_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lock of a process that was killed does not stay."""
    code = (
        "import sys, time; from pathlib import Path; from quadpend_train.training.run_folder import locked\n"
        "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        message = f"another process trains in {tmp_path}: wait until it ends, or choose another folder"
        assert_refused(lambda: train_policy(BRIEF, tmp_path), message, BlockingIOError)
        run_folder.write_json(tmp_path / "settings.json", training.to_mapping(BRIEF))
        with pytest.raises(SystemExit, match="2"):
            main(["train", "--resume", str(tmp_path)])
        assert capsys.readouterr().err == f"quadpend: {message}\n"
        process.kill()
    with locked(tmp_path):
        pass


def test_resume_warns_that_loading_executes_code(interrupted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["train", "--resume", str(interrupted), "--seed", "9"])
    assert "executes code that they contain: resume only runs that you trust" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="0"):
        main(["train", "--help"])
    assert "executes code that it contains: resume only runs that" in " ".join(
        capsys.readouterr().out.replace("│", " ").split()
    )


def test_provenance_of_a_run_names_its_command(interrupted: Path) -> None:
    assert "command" in json.loads((interrupted / "provenance.json").read_text())
