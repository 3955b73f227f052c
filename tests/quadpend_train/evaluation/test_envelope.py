"""The limit of an event is where a policy begins to fall."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import SCENARIOS, SETS, Scenario
from quadpend_train.evaluation import envelope
from quadpend_train.evaluation.envelope import Event, events, extra_delay, limit
from quadpend_train.evaluation.statistics import Interval
from tests.helpers.policies import synthetic_results

BREEZE = replace(SCENARIOS["flight_breeze"], duration=4.0)
WIND = """
[wind]
scenario = "flight_breeze"
unit = "mN"
highest = 1000.0
changes = {"wind.ornstein_uhlenbeck.force" = [0.0, 0.001]}
[start]
scenario = "flight_recovery_20"
unit = "°"
highest = 30.0
changes = {"task.start.pendulum_angle" = [0.0, 0.0174532925]}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (path := tmp_path / "events.toml").write_text(WIND, encoding="utf-8")
    return path


def test_strengths_change_the_settings_of_their_scenario_on_any_vehicle(file: Path) -> None:
    found = events(SCENARIOS["flight_breeze"], file)
    wind, start = found["wind"], found["start"]
    assert (wind.everyday, start.everyday) == pytest.approx((120.0, 20.0), rel=1e-3)
    assert wind.strengths[0] == pytest.approx(15.0)
    assert (wind.strengths[-1], start.strengths[-1]) == (1000.0, 30.0)
    assert start.strengths[-2] < 30.0 < 1.1 * start.strengths[-2]
    assert wind.at(500.0).wind[0].force == 0.5
    assert start.at(30.0).task.start.pendulum_angle == pytest.approx((0.5236, 0.5236), abs=1e-4)
    assert start.known == SCENARIOS["flight_recovery_20"]
    base = replace(SCENARIOS["flight_breeze"], latency=0.03, sensors={"kind": "noise", "position": 0.01})
    small = events(base.with_vehicle("crazyflie"), file)["wind"]
    share = small.known.vehicle.weight / SCENARIOS["flight_breeze"].vehicle.weight
    assert small.everyday == pytest.approx(120.0 * share)
    assert small.known.latency == 0.03
    assert small.known.sensors[0].position.white == 0.01
    (strong,) = small.at(2.0 * small.everyday).wind
    assert strong.scale * strong.wind.models[0].force == pytest.approx(0.002 * small.everyday)


def test_every_event_of_the_benchmark_is_searched_around_its_everyday_strength() -> None:
    found = events(SCENARIOS["flight_breeze"])
    assert [event.known.name for event in found.values()] == [*SETS["events"]]
    for event in found.values():
        assert event.strengths[0] == pytest.approx(event.everyday / 8.0)
        assert event.everyday < event.strengths[-1]
        assert event.at(event.everyday) == event.known
    assert found["drop-outs each second"].everyday == pytest.approx(100.0)
    assert found["loss of thrust"].everyday == pytest.approx(20.0)


def test_the_bisection_finds_the_limit_in_six_runs_and_its_interval_tells_what_was_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Episode k of 100 falls from the strength 20 + k/10 on, so two fall from 20.1."""
    runs: list[float] = []

    def run_job(job: Any, *_: Any) -> Any:
        runs.append(job.scenario.duration)
        survived = job.scenario.duration < 20.0 + 0.1 * np.arange(job.episodes)
        return synthetic_results(np.ones((len(job.policies), job.episodes)), survived)

    monkeypatch.setattr(envelope, "run_job", run_job)
    strengths = tuple(np.linspace(19.0, 22.0, 61).tolist())
    event = Event("s", 10.0, strengths, lambda x: Scenario(duration=x), Scenario())
    value, low, high = limit([controller("lqr")], event)
    assert value == pytest.approx(20.05)  # one fall of 100
    assert low < 20.0 < value < high
    assert 20.3 <= high <= 20.6
    assert len(runs) <= 6
    assert limit([controller("lqr")], replace(event, strengths=(1.0, 2.0))) == (2.0, 2.0, np.inf)
    assert limit([controller("lqr")], replace(event, strengths=(40.0, 50.0)))[:2] == (0.0, 0.0)
    found = envelope.envelope(
        {"one": Interval(20.0, 5.0, np.inf), "two": Interval(0.0, 0.0, 19.0)}, dict.fromkeys(("one", "two"), event)
    )
    assert found == pytest.approx((np.sqrt(2.0 * 1.9), 1.9, np.sqrt(2.2 * 1.9)))


def test_the_extra_delay_is_the_last_one_that_a_policy_that_is_not_told_survives() -> None:
    """LQR of the vehicle with torques tolerates some delay, and its linear loop about as much."""
    found = limit([controller("lqr")], extra_delay(BREEZE), 10)
    assert 10.0 < found.value < 80.0
    assert found.value / 2.5 == pytest.approx(round(found.value / 2.5))
    drawn = replace(BREEZE, loop={"latency": [0.01, 0.02]})
    assert extra_delay(drawn).at(5.0).loop.latency == pytest.approx((0.015, 0.025))
