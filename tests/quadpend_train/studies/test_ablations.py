"""Ablations and the time to beat run, briefly but for real."""

import json
from pathlib import Path

import pytest

from benchmarks import time_to_beat
from quadpend_train.studies import ablations
from quadpend_train.training.settings import TrainSettings, to_mapping
from tests.helpers.bad_input import assert_refused


@pytest.mark.parametrize("name", ablations.ABLATIONS)
def test_the_two_trainings_of_an_ablation_differ(name: str) -> None:
    without, added = (to_mapping(settings) for settings in ablations.settings_of(ablations.ABLATIONS[name], 4))
    assert without != added
    assert without["seed"] == added["seed"] == 4
    if name in ("deso", "kalman", "gsde", "paired residual", "paired pace"):
        assert sum(without[key] != added[key] for key in without) == 1


def test_an_ablation_is_trained_once_and_tabulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablations, "STEPS", 1)
    monkeypatch.setattr(ablations, "EPISODES", 2)
    outcome = ablations.run(tmp_path, 2, ("gsde",))["gsde"]
    assert outcome.difference.low <= outcome.added.value - outcome.without.value <= outcome.difference.high
    with monkeypatch.context() as patch:
        patch.setattr(ablations, "train", None)
        assert ablations.run(tmp_path, 2, ("gsde",)) == {"gsde": outcome}
    assert "| state-dependent exploration | windy | " in ablations.markdown({"gsde": outcome})
    assert set(json.loads((tmp_path / "ablations.json").read_text())) == {"gsde"}
    assert_refused(lambda: ablations.run(tmp_path, 1, ("nix",)), "no ablation 'nix'; there are tip", ValueError)


def test_a_goal_is_reached_when_two_blocks_of_episodes_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    brief = TrainSettings(total_timesteps=2048, num_envs=16, batch_size=256, ppo={"n_steps": 32, "n_epochs": 1})  # type: ignore[arg-type]
    monkeypatch.setattr(time_to_beat, "read_settings", lambda name: brief)
    asked: list[int] = []

    def judge(seed: int) -> time_to_beat.Judge:
        return lambda policy: asked.append(seed) is None and (seed == time_to_beat.SEEDS[0] or len(asked) > 2)

    never = time_to_beat.Goal("any", 512, 1.0, lambda seed: lambda policy: False)
    goals = {"soon": time_to_beat.Goal("any", 512, 1.0, judge), "never": never}
    monkeypatch.setattr(time_to_beat, "GOALS", goals)
    found = time_to_beat.measure(1, ("soon", "never"))
    assert asked == [*time_to_beat.SEEDS, *time_to_beat.SEEDS]
    assert found["soon"][0].steps == 1024
    assert found["never"][0].steps == float("inf")
    assert "| never | `any` | inf" in time_to_beat.markdown(found, 1e5)
