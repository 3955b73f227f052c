"""A run folder holds one run of one process; its files are complete, and damaged ones are written again or refused."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from stable_baselines3 import PPO

from quadpend_train.cli.main import main
from quadpend_train.common.files import temporary_name
from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
from quadpend_train.training import callbacks, run_folder
from quadpend_train.training import train as training
from quadpend_train.training.run_folder import locked
from quadpend_train.training.time_limit import TimeLimit
from quadpend_train.training.validation import Score, read_curve, write_curve
from tests.helpers.bad_input import assert_refused
from tests.helpers.policies import mlp_policy
from tests.helpers.training import APG, BRIEF, BRIEF_SAC, interrupt_at, train_policy

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
    for name in (temporary_name(1, "_checkpoint.zip"), "unfinished_another.host_1_checkpoint.zip", "unfinished_1_a"):
        (tmp_path / "run" / name).write_bytes(b"half")  # the lock ensures that no process writes them
    again, expected = train_policy(settings[1], tmp_path / "run"), train_policy(settings[1], tmp_path / "other")
    assert weight_difference(again, expected) == 0.0
    assert weight_difference(MlpPolicy.load(tmp_path / "run/start.npz"), MlpPolicy.load(starts[1])) == 0.0
    assert not list((tmp_path / "run").glob("unfinished*"))


def test_finished_run_loses_the_checkpoint_that_a_killed_process_left(tmp_path: Path) -> None:
    """Also what was to begin a continuation: `tests.helpers.kills` kills it at each operation."""
    train_policy(BRIEF, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    for name in ("checkpoint.zip", "buffer_512.pkl", "continued_provenance.json", "continued_settings.json"):
        (tmp_path / name).write_bytes(b"")
    assert_refused(lambda: training.resume(tmp_path), "is finished: there is nothing to resume", FileNotFoundError)
    assert {path.name for path in tmp_path.iterdir()} == names


def test_continuation_that_was_killed_is_recorded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train_policy(BRIEF, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(training, "to_mapping", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            training.extend(tmp_path, 256, progress=False)
    policy = MlpPolicy.load(training.extend(tmp_path, 256, progress=False))
    assert policy.card["provenance"]["continued_at"] == [1024]


DAMAGES: dict[str, Callable[[str], str] | None] = {
    "emptied": lambda text: "",
    "only the head": lambda text: text[: text.index("\n") + 1],
    "cut in a line": lambda text: text[:-4],
    "no number": lambda text: text.replace("256,", "2x6,"),
    "nan": lambda text: text.replace("256,", "256,nan,"),
    "other head": lambda text: text.replace("survival", "\x00"),
    "deleted": None,
}
every_damage = pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())


def damage_curve(folder: Path, damage: Callable[[str], str] | None) -> None:
    text = (folder / "curve.csv").read_bytes().decode()
    if damage is None:
        (folder / "curve.csv").unlink()
    else:
        (folder / "curve.csv").write_bytes(damage(text).encode())


def save_as_earlier_version(folder: Path) -> None:
    """Remove from the checkpoint what earlier versions did not write."""
    model = PPO.load(folder / "checkpoint.zip", device="cpu")
    del model.scores, model.best
    model.save(folder / "checkpoint.zip")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was not interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    train_policy(EVALUATED, folder)
    return folder


@pytest.mark.parametrize("earlier", [False, True], ids=["this version", "an earlier version"])
def test_resumed_run_has_the_scores_of_a_whole_one(
    earlier: bool, interrupted: Path, whole: Path, tmp_path: Path
) -> None:
    folder = copied(interrupted, tmp_path / "run")
    if earlier:
        save_as_earlier_version(folder)
    assert_equal_runs(training.resume(folder, progress=False).parent, whole)


def assert_equal_runs(folder: Path, whole: Path) -> None:
    scores = [[score._replace(seconds=0.0) for score in read_curve(run)] for run in (folder, whole)]
    assert scores[0] == scores[1]
    for name in ("best.npz", "policy.npz"):
        assert weight_difference(*(MlpPolicy.load(run / name) for run in (folder, whole))) == 0.0


@every_damage
def test_damaged_curve_is_written_again(
    damage: Callable[[str], str] | None, interrupted: Path, whole: Path, tmp_path: Path
) -> None:
    """The scores and the best policy are in the checkpoint."""
    folder = copied(interrupted, tmp_path / "run")
    damage_curve(folder, damage)
    (folder / "best.npz").write_bytes((folder / "best.npz").read_bytes()[:100])
    assert_equal_runs(training.resume(folder, progress=False).parent, whole)


@every_damage
def test_damaged_curve_of_an_earlier_version_is_refused_by_its_name(
    damage: Callable[[str], str] | None, interrupted: Path, tmp_path: Path
) -> None:
    folder = copied(interrupted, tmp_path / "run")
    save_as_earlier_version(folder)
    damage_curve(folder, damage)
    assert_refused(lambda: training.resume(folder, progress=False), r"run/curve.csv is damaged: it (lacks|is cut off)")
    assert not (folder / "policy.npz").exists()


def test_damaged_best_policy_of_an_earlier_version_is_refused_by_its_name(interrupted: Path, tmp_path: Path) -> None:
    folder = copied(interrupted, tmp_path / "run")
    save_as_earlier_version(folder)
    (folder / "best.npz").write_bytes((folder / "best.npz").read_bytes()[:100])
    assert_refused(lambda: training.resume(folder, progress=False), "run/best.npz is damaged: .* is not a policy file")
    (folder / "best.npz").unlink()
    assert_refused(lambda: training.resume(folder, progress=False), "run/best.npz is damaged: it does not exist")


@pytest.mark.parametrize("algo", ["ppo", "sac", "apg"])
def test_policy_of_a_dropped_evaluation_is_not_the_best(
    algo: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An evaluation after the checkpoint was the best; the resumed run stops before it repeats this evaluation."""
    base = {"ppo": BRIEF, "sac": BRIEF_SAC, "apg": APG}[algo]
    settings = replace(base, eval_freq=128, save_freq=256, total_timesteps=512, max_seconds=1e6)
    scores = iter([(1.0, rmse) for rmse in (0.5, 0.4, 0.3, 0.1)])
    with monkeypatch.context() as patch:
        patch.setattr(callbacks, "validate", lambda *_: next(scores))
        interrupt_at(450, patch)
        with pytest.raises(KeyboardInterrupt):
            train_policy(settings, tmp_path)
    late = MlpPolicy.load(tmp_path / "best.npz")
    with monkeypatch.context() as patch:
        patch.setattr(callbacks, "validate", lambda *_: (1.0, 0.6))
        patch.setattr(TimeLimit, "reached", lambda *_: True)
        policy = MlpPolicy.load(training.resume(tmp_path, progress=False))
    curve = [Score(*row) for row in policy.card["curve"]]
    assert min(score.penalised_rmse for score in curve) >= 0.3
    assert policy.card["best_at"] == min(curve, key=lambda score: score.penalised_rmse).steps
    assert weight_difference(policy, late) > 0.0
    assert weight_difference(policy, MlpPolicy.load(tmp_path / "best.npz")) == 0.0


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
