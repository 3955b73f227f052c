"""A blackbox and a companion's log of one flight become one log, whose clocks agree."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.identification import LISTED, random_vehicle
from experiments.simulated_logs import Noise, simulated_log
from quadpend_gym.core.arrays import Floats
from quadpend_train.cli.main import main
from quadpend_train.flight_logs.identify import identify
from quadpend_train.flight_logs.log import FlightLog, rate_of_attitude
from quadpend_train.flight_logs.merge import merge
from quadpend_train.flight_logs.replay import compare
from tests.helpers.logs import save

VEHICLE, START, TRUTH = random_vehicle(1)
SHIFT, DRIFT, DURATION = 3.2137, 60e-6, 20.0  # s, s/s, s


@pytest.fixture(scope="module")
def companion() -> FlightLog:
    """A log with motion capture at 100 Hz, whose motors say nothing."""
    log = simulated_log(VEHICLE, 1, Noise(delay=0.0), DURATION)
    return replace(log, motors=0.0 * log.motors + 500.0, rate=rate_of_attitude(log.rotation, log.period))


@pytest.fixture(scope="module")
def blackbox() -> FlightLog:
    """A log at 200 Hz without positions, with another begin, another end and a faster clock."""
    log = simulated_log(VEHICLE, 2, Noise(delay=0.0, rate_of_log=200.0), DURATION)
    times = SHIFT + np.arange(0.0, DURATION - SHIFT - 1.5, log.period) / (1.0 + DRIFT)
    count = len(times)

    def then(values: Floats) -> Floats:
        return np.column_stack([np.interp(times, log.period * np.arange(len(log)), x) for x in values.T])

    nowhere = {"position": np.zeros((count, 3)), "velocity": np.zeros((count, 3))}
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    found = replace(log, rate=then(log.rate), motors=then(log.motors), **nowhere)
    return replace(found, name="blackbox", quaternion=level, valid=np.full(count, True), has_position=False)


def test_the_clocks_are_found_between_samples_and_the_vehicle_is_identified(
    companion: FlightLog, blackbox: FlightLog
) -> None:
    found = merge(companion, blackbox)
    assert found.shift == pytest.approx(SHIFT, abs=0.0005)
    assert found.drift == pytest.approx(DRIFT, abs=40e-6)
    assert found.correlation > 0.99
    assert len(found.log) == pytest.approx((DURATION - SHIFT - 1.5) / companion.period, abs=5)
    assert found.sentence("flight.bbl").startswith("flight.bbl begins 3.21")
    identified = identify([found.log], START)
    for name in LISTED:
        assert identified.estimates[name].value == pytest.approx(TRUTH[name], rel=0.05), name
    assert identified.delay == pytest.approx(0.0, abs=0.002)
    errors = compare(identified.held_out[0], {"new": identified.vehicle}, delay=identified.delay)
    for channel in ("position", "attitude", "rate"):
        assert (errors["new"][channel][[10, -1]] < 0.5 * errors["held"][channel][[10, -1]]).all()


def test_logs_of_two_flights_are_refused(companion: FlightLog, blackbox: FlightLog) -> None:
    other = replace(blackbox, rate=np.random.default_rng(0).permutation(blackbox.rate))
    with pytest.raises(
        ValueError, match="'simulated' and 'blackbox' must be of one flight, but their body rates have a"
    ):
        merge(companion, other)


def test_replay_takes_a_blackbox_for_its_log(
    companion: FlightLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(companion, tmp_path / "log.csv")
    save(companion.cut(321, len(companion)), tmp_path / "gyro.csv")
    command = "replay", str(tmp_path / "log.csv"), "--vehicle", "hummingbird", "--blackbox", str(tmp_path / "gyro.csv")
    main([*command])
    shown = capsys.readouterr().out
    assert "gyro.csv begins 3.21" in shown
    assert "attitude, °         hummingbird" in shown
    with pytest.raises(SystemExit):
        main([*command, str(tmp_path / "gyro.csv")])
    assert "--blackbox must be as many files as there are logs, 1, not 2" in capsys.readouterr().err
