"""A sweep writes a settings file that training takes, continues, and stops bad trials early."""

import csv
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.trial import TrialState

from quadpend_train.cli.main import main
from quadpend_train.common.files import toml_text, write_text
from quadpend_train.studies.search import search_space, sweep
from quadpend_train.training.settings import ALGORITHMS, PRESETS, TrainSettings, read_settings, to_mapping
from quadpend_train.training.validation import Score, write_curve
from tests.helpers.training import BRIEF

SPACE = """
learning_rate = { low = 1e-4, high = 1e-2, log = true }
batch_size = [64, 128]
net_arch = [[8], [8, 4]]
ppo.n_epochs = { low = 1, high = 4 }
"""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files start.toml and space.toml, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    write_text(tmp_path / "start.toml", toml_text(to_mapping(BRIEF)))
    write_text(tmp_path / "space.toml", SPACE)
    return tmp_path


def rows(folder: Path) -> list[dict[str, str]]:
    """The table of the trials."""
    with (folder / "sweep/trials.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_sweep_writes_settings_that_train_takes_and_continues(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["sweep", "start.toml", "--space", "space.toml", "--seconds", "4", "--out", "sweep"]
    main([*command, "--trials", "2"])
    first = rows(files)
    assert [row["state"] for row in first] == ["complete", "complete"]
    assert first[0]["batch_size"] == "128"
    printed = capsys.readouterr().out
    assert "quadpend train --settings sweep/best.toml" in printed
    assert "In 200 episodes of each scenario that the search has not used" in printed
    assert "the search is blind" in printed  # every policy falls in these scenarios
    main([*command, "--trials", "4", "--jobs", "2"])
    again = rows(files)
    assert again[:2] == first
    assert {row["state"] for row in again} == {"complete"}
    assert 4 <= len(again) <= 5
    best = min(again, key=lambda row: float(row["penalised_rmse"]))
    found = read_settings("sweep/best.toml")
    assert found.learning_rate == float(best["learning_rate"])
    assert (found.max_seconds, found.eval_freq, found.num_envs) == (0.0, 0, BRIEF.num_envs)
    assert (files / "sweep/sweep.png").stat().st_size > 5000
    main(["train", "--settings", "sweep/best.toml", "--total-timesteps", "256", "--out", "run"])
    assert (files / "run/policy.npz").is_file()


def searched(tmp_path: Path, **changes: Any) -> sweep.Sweep:
    """A sweep over the learning rate."""
    start = replace(BRIEF, **changes)
    write_text(tmp_path / "space.toml", "learning_rate = { low = 1e-4, high = 1e-2, log = true }\n")
    return sweep.Sweep(start, search_space.read_space(tmp_path / "space.toml", start), 10.0)


def test_trials_worse_than_the_median_after_the_same_time_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths: list[int] = []

    def train(settings: TrainSettings, folder: Path, *, callbacks: Any, **_: Any) -> Path:
        """Make an evaluation each second; the last trials are the worst ones."""
        folder.mkdir(parents=True)
        lengths.append(0)
        for second in range(10):
            rmse = 0.1 * len(lengths) / (1 + second)
            write_curve(folder, [*sweep.read_curve(folder), Score(100 * second, float(second), 1.0, rmse)])
            lengths[-1] += 1
            callbacks[0]._on_rollout_start()
        (folder / "policy.npz").touch()
        return folder / "policy.npz"

    class Loaded:
        card = {"score": {"penalised_rmse": 0.5}}  # noqa: RUF012

    monkeypatch.setattr(sweep, "train", train)
    monkeypatch.setattr(sweep, "_warm_up", lambda settings: None)
    monkeypatch.setattr(sweep.MlpPolicy, "load", lambda _: Loaded)
    study = sweep.search(searched(tmp_path), 6, tmp_path / "out")
    states = [trial.state for trial in study.trials]
    assert states == [TrialState.COMPLETE] * 4 + [TrialState.PRUNED] * 2
    assert lengths == [10] * 4 + [4] * 2  # a quarter of the time passes before the first comparison
    assert {path.name for path in (tmp_path / "out" / study.study_name).iterdir()} == {"0", "1", "2", "3"}
    assert "pruned" in sweep.table(study, searched(tmp_path))
    assert "the search is blind" in sweep.advice(study)  # all have the score of the same card


def test_a_training_that_fails_does_not_end_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def train(settings: TrainSettings, *_: Any, **__: Any) -> Path:
        raise FloatingPointError("training diverged")

    monkeypatch.setattr(sweep, "train", train)
    monkeypatch.setattr(sweep, "_warm_up", lambda settings: None)
    with pytest.raises(ValueError, match=r"no training of the sweep came to its end: training diverged"):
        sweep.search(searched(tmp_path), 2, tmp_path / "out")


def test_sweeps_with_other_settings_are_other_studies(tmp_path: Path) -> None:
    one = searched(tmp_path)
    assert one.name == searched(tmp_path).name
    others = [searched(tmp_path, gamma=0.9), one._replace(seed=1), one._replace(seconds=5.0)]
    assert len({one.name, *(other.name for other in others)}) == 4


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_the_presets_are_in_the_search_space_of_their_algorithm(algo: str) -> None:
    start = read_settings(algo)
    space = search_space.read_space(None, start)
    values = search_space.start_values(space, start)
    assert to_mapping(search_space.with_values(start, values)) == to_mapping(start)
    for name, distribution in space.items():
        assert distribution._contains(distribution.to_internal_repr(values[name])), name


def test_settings_written_as_toml_are_read_unchanged(tmp_path: Path) -> None:
    for path in PRESETS.glob("*.toml"):
        settings = read_settings(path.stem)
        write_text(tmp_path / "settings.toml", toml_text(to_mapping(settings)))
        assert read_settings(str(tmp_path / "settings.toml")) == settings


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("leaning_rate = [1.0]", "not a setting of ppo .did you mean"),
        ("sac.tau = [0.1]", "which is not a setting of ppo"),
        ("learning_rate = 0.1", r"must be \{low"),
        ("learning_rate = {low = 0.0, high = 1.0, log = true}", "learning_rate is not a permitted range"),
        ("learning_rate = {low = 1e-4}", r"must be \{low"),
        ("net_arch = {low = 1, high = 2}", "give a list"),
        ("batch_size = [100]", "batch_size must divide"),
        ("ppo.n_epochs = {low = 1.5, high = 3}", "low must be a whole number"),
        ("gamma = [2.0]", "gamma must be"),
        ("gamma = {low = 'a', high = 1.0}", "low must be a number"),
        ("", "at least one range"),
    ],
)
def test_a_wrong_search_space_is_refused(text: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "space.toml"
    write_text(path, text)
    with pytest.raises(ValueError, match=sentence):
        search_space.read_space(path, BRIEF)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["pppo"], "settings must be"),
        (["start.toml", "--trials", "0"], "trials must"),
        (["start.toml", "--seconds", "nan"], "seconds must"),
        (["start.toml", "--eval-freq", "-1"], "eval_freq must"),
        (["start.toml", "--storage", "space.toml"], "storage must be a file of Optuna's journal"),
    ],
)
def test_wrong_options_of_sweep_are_refused(
    options: list[str], sentence: str, files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["sweep", *options, "--space", "space.toml", "--out", "sweep"])
    assert sentence in capsys.readouterr().err


def test_importances_are_those_of_the_search() -> None:
    from quadpend_train.reports import search_plots

    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    study.optimize(lambda trial: trial.suggest_float("a", 0, 1) ** 2 + 1e-3 * trial.suggest_float("b", 0, 1), 60)
    shares = search_plots.importances(study)
    assert shares["a"] > 0.7
    assert search_plots.draw(study, "value").axes[1].get_yticklabels()[-1].get_text() == "a"


@pytest.mark.extras
def test_ray_tune_continues_a_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray.tune", reason="needs Ray: pip install 'quadpend-gym[cluster]'")
    from quadpend_train.studies.search import ray_sweep

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    one = searched(tmp_path)._replace(seconds=4.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Ray
        for trials in (2, 2):  # the second search makes no trial
            study = ray_sweep.search(one, trials, tmp_path, None, "local")
            assert [trial.state for trial in study.trials] == [TrialState.COMPLETE] * 2
    assert study.trials[0].params == {"learning_rate": BRIEF.learning_rate}
    assert sweep.search(one, 3, tmp_path).trials[2].state == TrialState.COMPLETE


def test_a_sweep_on_a_cluster_names_the_missing_package(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SystemExit):
        main(["sweep", "start.toml", "--space", "space.toml", "--out", "sweep", "--cluster", "local"])
    assert "pip install 'quadpend-gym[cluster]'" in capsys.readouterr().err


def test_a_training_in_another_thread_ends(tmp_path: Path) -> None:
    """Ray Tune trains in a thread, in which Python permits no handler of a signal."""
    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(sweep.train, BRIEF, tmp_path / "run", progress=False).result().is_file()
