"""The limit of an event is where a policy begins to fall."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.core.nested import changed
from quadpend_gym.scenarios import SCENARIOS, SETS, Scenario
from quadpend_gym.wind.base import HAND, Sum
from quadpend_train.evaluation import envelope
from quadpend_train.evaluation.envelope import DELAY, Event, Limit, events, limit
from quadpend_train.evaluation.episodes import run_episodes
from tests.helpers.policies import synthetic_results
from tests.helpers.wind import sample_wind

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
    delay = found.pop(DELAY)
    assert (delay.strengths[0], delay.everyday, delay.strengths[-1]) == pytest.approx((2.5, 15.0, 100.0))
    assert [event.known.name for event in found.values()] == [*SETS["events"]]
    for event in found.values():
        assert event.strengths[0] == pytest.approx(event.everyday / 8.0)
        assert event.everyday in event.strengths[:-1]
        assert event.at(event.everyday) == event.known
    assert found["drop-outs each second"].everyday == pytest.approx(100.0)
    assert found["loss of thrust"].everyday == pytest.approx(20.0)


def test_an_event_adds_to_a_scenario_and_replaces_nothing_that_it_can_keep() -> None:
    gentle = SCENARIOS["flight_breeze"]
    own = replace(
        gentle,
        wind=[{"kind": "constant", "force": [0.1, 0.0, 0.0]}],
        loop={"latency": [0.01, 0.03], "changes": {"at": [1.0, 2.0], "latency": [0.03, 0.03]}},
        parameters={"quadrotor_mass": [0.4, 0.6], "rod_length": [0.5, 0.6]},
        task="track",
        pole_told=True,
        duration=8.0,
    )
    made = {name: event.known for name, event in events(own).items()}
    assert made.pop(DELAY) == own
    for name, scenario in made.items():
        assert scenario.task == SCENARIOS[scenario.name].task
        assert own.wind[0] in scenario.wind, name
        assert scenario.duration == 8.0
        assert scenario.loop.latency == (0.01, 0.03)
        assert scenario.loop.changes.latency == (0.03, 0.03)
        assert scenario.parameters.quadrotor_mass == (0.4, 0.6)
        assert scenario.pole_told == (name != "pole not as believed")
    assert made["jump of the set-point"].task.jumps == SCENARIOS["event_jump"].task.jumps
    assert made["step of the wind"].wind == (*own.wind, *SCENARIOS["event_wind_step"].wind)
    changes = made["loss of thrust"].loop.changes
    assert (changes.at, changes.thrust) == (SCENARIOS["event_thrust"].loop.changes.at, (0.8, 0.8))
    mass, length = (getattr(made["pole not as believed"].parameters, name) for name in ("bob_mass", "rod_length"))
    assert (mass, length) == (pytest.approx((0.0425, 0.0575)), pytest.approx((0.48025, 0.64975)))


def test_a_hand_pulls_alike_at_every_vehicle() -> None:
    made = [SCENARIOS["flight_breeze"].with_vehicle(name) for name in ("hummingbird", "crazyflie", "racer")]
    catches = [events(one)["held pole let go"].known for one in made]
    first, *others = (sample_wind(Sum(catch.wind_models), 1, 50, columns=HAND) for catch in catches)
    for hand in others:
        np.testing.assert_array_equal(hand, first)


def test_the_bisection_begins_at_the_everyday_strength_and_its_bracket_tells_what_was_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Episode k of 100 falls from the strength 20 + k/10 on, so two fall from 20.1, and four from 20.3."""
    runs: list[float] = []

    def run_job(job: Any, *_: Any) -> Any:
        runs.append(job.scenario.duration)
        assert job.enough == 4 * len(job.policies)  # 3 falls of 100 do not exclude a survival of 99 %
        survived = job.scenario.duration < 20.0 + 0.1 * np.arange(job.episodes)
        return synthetic_results(np.ones((len(job.policies), job.episodes)), survived)

    monkeypatch.setattr(envelope, "run_job", run_job)
    strengths = tuple(np.linspace(19.0, 22.0, 61).tolist())
    event = Event("s", 19.5, strengths, lambda x: Scenario(duration=x), Scenario())
    for seeds in (1, 5):  # each of which flies all episodes
        found = limit([controller("lqr")] * seeds, event)
        assert runs[0] == pytest.approx(19.5)
        assert found.value == pytest.approx(20.05)  # one fall of 100
        assert 19.5 <= found.clean < 20.0
        assert 20.3 <= found.failed <= 20.75
        assert found.room == 0.0
        assert len(runs) <= 7
        runs.clear()
    most, least = (limit([controller("lqr")], replace(event, strengths=ends)) for ends in ((1.0, 2.0), (40.0, 50.0)))
    assert str(most) == "≥ 2.00 (2.00, –)"
    assert str(least) == "< 40.0 (–, 40.0)"
    events = dict.fromkeys(("one", "two", DELAY), event)
    found = envelope.envelope({"one": Limit(20.0, 5.0, np.inf), "two": Limit(19.0, 0.0, 19.0, "<")}, events)
    ends = np.array([20.0 * 19.0, 19.0**2, 22.0 * 19.0])
    assert found[:3] == pytest.approx(np.sqrt(ends) / 19.5)
    assert found.sign == "<"
    both = envelope.envelope(
        {"one": most, "two": least}, {name: replace(event, strengths=(2.0, 40.0)) for name in events}
    )
    assert str(both).startswith("≈ ")


def test_a_run_ends_with_the_fall_that_decides_and_falls_as_before_until_then() -> None:
    steep = {"task.start.pendulum_angle": (0.87, 0.87), "duration": 3.0}
    scenario = changed(SCENARIOS["flight_recovery_20"], steep)
    policies = [controller("lqr"), controller("lqr")]
    every, some = run_episodes(policies, scenario, 8), run_episodes(policies, scenario, 8, enough=3)
    assert len(some.cause) == 1  # the second policy does not fly
    fallen = some.cause > 0
    assert 3 <= np.sum(fallen) < np.sum(every.cause[0] > 0)
    np.testing.assert_array_equal(some.steps[fallen], every.steps[:1][fallen])
    assert some.steps.max() < every.steps.max()


def test_the_extra_delay_is_the_last_one_that_a_policy_that_is_not_told_survives() -> None:
    """LQR of the vehicle with torques tolerates some delay, and its linear loop about as much."""
    found = limit([controller("lqr")], events(BREEZE)[DELAY], 10)
    assert 10.0 < found.value < 80.0
    assert found.value / 2.5 == pytest.approx(round(found.value / 2.5))
    drawn = replace(BREEZE, loop={"latency": [0.01, 0.02]})
    assert events(drawn)[DELAY].at(5.0).loop.latency == pytest.approx((0.015, 0.025))
