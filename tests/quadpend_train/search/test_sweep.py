"""A sweep writes settings that training takes, continues, and stops bad trials early."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from optuna.trial import TrialState

from quadpend_train.cli.main import main
from quadpend_train.common.files import write_text
from quadpend_train.search import sweep
from quadpend_train.search.shared import flat
from quadpend_train.training.callbacks import Score
from quadpend_train.training.settings import TrainSettings, read_settings, to_mapping
from tests.helpers.training import BRIEF

SPACE = """
reward_scale = { low = 0.01, high = 1.0, log = true }
ppo.batch_size = [64, 128]
ppo.policy_kwargs.net_arch = [[8], [8, 4]]
ppo.n_epochs = { low = 1, high = 4 }
"""


def test_a_sweep_writes_settings_that_train_takes_and_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def rows() -> list[dict[str, str]]:
        return list(csv.DictReader(Path("sweep/trials.csv").read_text(encoding="utf-8").splitlines()))

    monkeypatch.chdir(tmp_path)
    Path("start.json").write_text(json.dumps(to_mapping(BRIEF)))
    Path("space.toml").write_text(SPACE)
    command = ["sweep", "start.json", "--space", "space.toml", "--seconds", "4", "--out", "sweep"]
    main([*command, "--trials", "2"])
    first = rows()
    assert [row["state"] for row in first] == ["COMPLETE", "COMPLETE"]
    assert first[0]["params_ppo.batch_size"] == "128"
    printed = capsys.readouterr().out
    assert "the search is blind" in printed  # every policy falls in these scenarios
    main([*command, "--trials", "4", "--jobs", "2"])
    assert rows()[:2] == first
    assert 4 <= len(rows()) <= 5
    best = min(rows(), key=lambda row: float(row["value"]))
    found = read_settings("sweep/best.json")
    assert found.reward_scale == float(best["params_reward_scale"])
    assert (found.max_seconds, found.eval_freq) == (0.0, 0)
    assert Path("sweep/sweep.png").stat().st_size > 5000


def searched(tmp_path: Path, **changes: Any) -> sweep.Sweep:
    """A sweep over the scale of the rewards."""
    start = replace(BRIEF, **changes)
    write_text(tmp_path / "space.toml", "reward_scale = { low = 1e-4, high = 1e-2, log = true }\n")
    return sweep.Sweep(
        start, *sweep.read_space(tmp_path / "space.toml", start), 10.0, tmp_path / "out", str(tmp_path / "trials.log")
    )


def test_trials_worse_than_the_median_after_the_same_time_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths: list[int] = []

    def train(settings: TrainSettings, folder: Path, *, callbacks: Any = (), **_: Any) -> Path:
        """Make an evaluation each second; the last trials are the worst ones."""
        folder.mkdir(parents=True)
        lengths.extend([0] if callbacks else [])
        scores: list[Score] = []
        for callback in callbacks:
            callback.model = SimpleNamespace(scores=scores)
        for second in range(10 if callbacks else 0):
            rmse = 0.1 * len(lengths) / (1 + second)
            scores.append(Score(100 * second, float(second), 1.0, rmse))
            lengths[-1] += 1
            callbacks[0]._on_rollout_start()
        (folder / "policy.npz").touch()
        return folder / "policy.npz"

    class Loaded:
        card = {"score": {"penalised_rmse": 0.5}}  # noqa: RUF012

    monkeypatch.setattr(sweep, "train", train)
    monkeypatch.setattr(sweep.MlpPolicy, "load", lambda _: Loaded)
    study = sweep.search(searched(tmp_path), 6)
    states = [trial.state for trial in study.trials]
    assert states == [TrialState.COMPLETE] * 4 + [TrialState.PRUNED] * 2
    assert lengths == [10] * 4 + [4] * 2  # a quarter of the time passes before the first comparison
    assert {path.name for path in (tmp_path / "out" / study.study_name).iterdir()} == {"0", "1", "2", "3"}


def test_a_training_that_fails_does_not_end_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def train(settings: TrainSettings, *_: Any, callbacks: Any = (), **__: Any) -> None:
        if callbacks:
            raise FloatingPointError("training diverged")

    monkeypatch.setattr(sweep, "train", train)
    with pytest.raises(ValueError, match=r"no training of the sweep came to its end: training diverged"):
        sweep.search(searched(tmp_path), 2)


@pytest.mark.parametrize("algo", ["ppo", "sac", "tqc", "apg"])
def test_the_presets_are_in_the_search_space_of_their_algorithm(algo: str) -> None:
    start = read_settings(algo)
    ranges, values = sweep.read_space(None, start)
    for name, distribution in ranges.items():
        assert distribution._contains(distribution.to_internal_repr(values[name])), name
    unset = {name for name in values if name not in dict(flat(to_mapping(start)))}
    kept = {name: value for name, value in values.items() if name not in unset}
    assert sweep.proposed(start, kept) == start


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("leaning_rate = [1.0]", "has no field 'leaning_rate'"),
        ("sac.tau = [0.1]", "has no field 'sac'"),
        ("ppo.learning = [0.1]", "ppo has no argument 'learning'"),
        ("reward_scale = 0.1", r"reward_scale must be \{low"),
        ("reward_scale = {low = 0.0, high = 1.0}", "reward_scale must be a finite number from 1e-09"),
        ("reward_scale = {low = 1e-4}", r"must be \{low"),
    ],
)
def test_a_wrong_search_space_is_refused(text: str, sentence: str, tmp_path: Path) -> None:
    write_text(tmp_path / "space.toml", text)
    with pytest.raises(ValueError, match=sentence):
        sweep.read_space(tmp_path / "space.toml", BRIEF)


def test_a_file_that_is_no_storage_is_refused(tmp_path: Path) -> None:
    (tmp_path / "trials.log").write_text("no journal")
    with pytest.raises(ValueError, match=r"the storage .*trials.log cannot be opened"):
        searched(tmp_path).open()
