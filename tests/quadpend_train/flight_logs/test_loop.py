"""The latency and the rate loop of a vehicle follow from a log of `quadpend fly`."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments import hidden_vehicles
from experiments.hidden_vehicles import CURVE, LATENCY, START, Loop, flown_log, hidden_loop
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.vehicles import RateLoop, rotors_of
from quadpend_train.cli.main import main
from quadpend_train.flight_logs import loop
from quadpend_train.flight_logs.loop import loop_of
from quadpend_train.links.flight import COLUMNS
from quadpend_train.policies.compiled import samples_of
from quadpend_train.policies.loading import load_policy

LAG, AHEAD = 0.015, 7.0  # s: of the hummingbird's rotors; by which the clock of the samples is ahead


def flown(latency: float, time_constant: float, seed: int = 0, steps: int = 800) -> pd.DataFrame:
    """What `fly` logs of a hover, with every tenth sample lost."""
    scenario = find_scenarios(["flight_breeze"])["flight_breeze"]
    vehicle = replace(scenario.vehicle, rate_loop=RateLoop(time_constant=time_constant))
    scenario = replace(scenario, vehicle=vehicle, latency=latency, observation="lab")
    policy, envs, memory = load_policy("lqg").adapt(scenario), scenario.make_vec(1), None
    observation, _ = envs.reset(seed=seed)
    rows, scale = [], scenario.simulation.command_scale
    for step in range(steps):
        action, memory = policy.predict(observation, memory, np.array([step == 0]))
        command = scale * action[0].astype(float) + [scale[0], 0.0, 0.0, 0.0]
        sample = np.append(samples_of(observation)[0, :10], 0.01 * step + AHEAD)
        sample[:] = np.nan if step % 10 == 9 else sample
        rows.append([0.01 * step, *sample, *command])
        observation, *_ = envs.step(action)
    names = "time", "x", "y", "z", "qw", "qx", "qy", "qz", "rx", "ry", "rz", "exposure", "thrust"
    table = pd.DataFrame(rows, columns=[*names, "rate_x", "rate_y", "rate_z"]).reindex(columns=COLUMNS)
    return table.assign(stage="FLY")


@cache
def hover() -> pd.DataFrame:
    """A log with 20 ms of both."""
    return flown(0.02, 0.02)


@pytest.mark.parametrize(("latency", "time_constant"), [(0.01, 0.02), (0.03, 0.02), (0.02, 0.03)])
def test_a_log_of_eight_seconds_shows_the_loop(latency: float, time_constant: float) -> None:
    found = loop_of(flown(latency, time_constant), LAG)
    assert found.latency == pytest.approx(latency, abs=0.0015)
    assert found.time_constant == pytest.approx(time_constant, rel=0.06)
    assert max(found.deviations) < 0.001


@pytest.mark.parametrize("steps", [True, False])
@pytest.mark.parametrize("time_constant", [0.02, 0.05])
def test_without_quick_commands_only_the_sum_is_known(
    steps: bool, time_constant: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not steps:
        monkeypatch.setattr(hidden_vehicles, "_STEPS", (0.0, 0.0))
    vehicle = hidden_loop(4).vehicle
    vehicle = replace(vehicle, rate_loop=replace(vehicle.rate_loop, time_constant=time_constant))
    true = replace(hidden_loop(4), latency=0.02, vehicle=vehicle)
    found = loop_of(flown_log(true, Loop(START, LATENCY, CURVE), 4), rotors_of(true.vehicle).lag_up)
    assert found.is_split == steps
    assert ("only the sum" in found.sentence()) != steps
    assert sum(found[:2]) == pytest.approx(0.02 + time_constant, abs=0.0015)
    if steps:
        assert found[:2] == pytest.approx((0.02, time_constant), abs=0.0015)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"rate_x": 0.0, "rate_y": 0.0}, "not 0% of it: fly quicker, or check their axes"),
        ({"rate_x": lambda table: -57.3 * table.rate_x}, "check their axes, their signs, and the units"),
        ({"rate_x": "lost"}, "the log 'flight' has 'lost' in column 'rate_x' of row 1"),
        ({"exposure": lambda table: table.exposure.where(table.index < 400, table.exposure - 2.0)}, "do not go back"),
        ({"stage": "OFF"}, "not 0"),
    ],
)
def test_a_log_without_the_loop_is_refused(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        loop_of(hover().assign(**change), LAG)


def test_the_loop_is_that_of_the_samples_that_there_are() -> None:
    """Of neither gaps, nor cells without a number, nor lost attitudes."""
    table = hover().astype({"rate_x": float})
    table.loc[30, "rate_x"] = np.nan
    table.loc[500, "qw"] = np.nan
    table.loc[510, ["qw", "qx", "qy", "qz"]] = 0.0
    found = loop_of(table[(table.index < 300) | (table.index > 400)], LAG)
    assert found[:2] == pytest.approx((0.02, 0.02), abs=0.0015)


def test_identify_prints_the_loop_and_refuses_logs_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, columns = tmp_path / "log.csv", tmp_path / "log.toml"
    table = hover()
    table.to_csv(log, index=False)
    columns.write_text("seconds = [0.0, 1.5]")
    command = "identify", str(log), "--vehicle", "hummingbird", "--loop"
    main([*command])
    assert str(log) in (shown := capsys.readouterr().out)
    assert "latency 2" in shown or "latency 1" in shown
    with pytest.raises(SystemExit):
        main([*command, "--columns", str(columns)])
    assert (
        "the log 'log' must have at least 200 samples in flight in seconds 0 to 1.5, not 1" in capsys.readouterr().err
    )
    with pytest.raises(ValueError, match="from a log of `quadpend fly`, which has a column 'exposure'"):
        loop_of(table.drop(columns="exposure"), LAG)
    sentence = loop.Loop(0.02, 0.03, (0.001, 0.0015)).sentence()
    assert sentence.startswith("latency 20.0 ms (17.9 to 22.1), rate_loop.time_constant 30.0 ms (26.9 to 33.1)")
