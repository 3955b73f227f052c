"""The benchmark of the training time runs with small sizes."""

import pytest

from benchmarks import time_to_beat
from quadpend_train.training.settings import TrainSettings


def test_a_goal_is_reached_when_two_blocks_of_episodes_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    brief = TrainSettings(
        total_timesteps=2048, num_envs=16, arguments={"n_steps": 32, "n_epochs": 1, "batch_size": 256}
    )
    monkeypatch.setattr(time_to_beat, "read_settings", lambda name: brief)
    checked: list[int] = []

    def make_check(seed: int) -> time_to_beat.Check:
        """The check of the second block fails at its first call."""
        first, _ = time_to_beat.BLOCK_SEEDS
        return lambda policy: checked.append(seed) is None and (seed == first or len(checked) > 2)

    never = time_to_beat.Goal("any", 512, 1.0, lambda seed: lambda policy: False)
    goals = {"soon": time_to_beat.Goal("any", 512, 1.0, make_check), "never": never}
    monkeypatch.setattr(time_to_beat, "GOALS", goals)
    times = time_to_beat.measure(1, ("soon", "never"))
    assert checked == [*time_to_beat.BLOCK_SEEDS, *time_to_beat.BLOCK_SEEDS]
    assert times["soon"][0].steps == 1024
    assert times["never"][0].steps == float("inf")
    assert "| never | `any` | inf" in time_to_beat.markdown(times, 1e5)
