"""Flight logs: readers, replay, identification, and the files that follow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from experiments.identification import LISTED, random_pole, random_vehicle
from experiments.simulated_logs import Noise, simulated_log
from quadpend_gym.scenarios import SCENARIOS, find_scenarios
from quadpend_gym.vehicles import Vehicle
from quadpend_gym.vehicles.vehicle import as_vehicle
from quadpend_train.cli.main import main
from quadpend_train.flight_logs.identify import Found, check_log, check_motion, doubts_of, identify, possible
from quadpend_train.flight_logs.log import Columns, FlightLog, make_log, pole_motion
from quadpend_train.flight_logs.readers import PX4, read_log
from quadpend_train.flight_logs.replay import Thrust, compare, errors, fly, windows_of, without_pole
from quadpend_train.flight_logs.vehicle_file import write_vehicle
from tests.helpers.logs import save

SEED = 1
DATA, NANOBENCH = Path("tests/data/nanobench"), "experiments/columns/nanobench.toml"
EXACT = Noise(position=0.0, attitude=0.0, rate=0.0, motors=0.0, pole=0.0, delay=0.0, rate_of_log=200.0)


@pytest.fixture(scope="module")
def log() -> FlightLog:
    return simulated_log(random_vehicle(SEED)[0], SEED, duration=16.0)


@pytest.fixture(scope="module")
def found(log: FlightLog) -> Found:
    return identify([log], random_vehicle(SEED)[1])


@pytest.fixture(scope="module")
def hanging() -> FlightLog:
    return simulated_log(random_pole(random_vehicle(SEED)[0], SEED)[0], SEED, duration=16.0, side=-1.0)


def motors_table(log: FlightLog, path: Path) -> pd.DataFrame:
    save(log, path)
    return pd.read_csv(path)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_replay_of_an_exact_log_repeats_it_with_its_pole(side: float) -> None:
    vehicle = random_vehicle(SEED)[0]
    log = simulated_log(vehicle, 0, EXACT, duration=4.0, side=side)
    windows = windows_of(log, 0.5, 0.1)
    motion = fly(windows, vehicle, Thrust(vehicle.rotors.thrust_coefficient), delay=0.5 * log.period)  # type: ignore[union-attr]
    last = errors(motion, windows)[-1]
    assert np.abs(last[:, 6:9]).max() < 5e-3  # rad; the velocities of the log are smoothed
    assert np.abs(last[:, 12:]).max() < 5e-3


def test_a_log_survives_its_csv_file(log: FlightLog, tmp_path: Path) -> None:
    save(log, tmp_path / "log.csv")
    again = read_log(tmp_path / "log.csv")
    assert again.period == pytest.approx(log.period)
    for name in ("position", "velocity", "quaternion", "rate", "motors"):
        assert_allclose(getattr(again, name), getattr(log, name)[: len(again)], atol=1e-6)


def test_the_direction_of_a_pole_may_have_any_length(hanging: FlightLog, tmp_path: Path) -> None:
    table = motors_table(hanging, tmp_path / "log.csv")
    table[["rx", "ry", "rz"]] *= 0.7
    again = make_log("log", table, Columns(pole_direction=("rx", "ry", "rz")))
    assert again.pole is not None
    assert hanging.pole is not None
    assert_allclose(again.pole[:, :3], hanging.pole[: len(again), :3], atol=1e-6)


def test_units_and_frames_of_columns_are_converted(log: FlightLog, tmp_path: Path) -> None:
    table = motors_table(log, tmp_path / "log.csv")
    down = table * np.where(table.columns.isin(["y", "z", "vy", "vz", "qy", "qz", "wy", "wz"]), -1.0, 1.0)
    down["time"] *= 1e6
    px4 = make_log("down", down, replace(PX4, motors=("motor1", "motor2", "motor3", "motor4")))
    assert_allclose(px4.position, log.position[: len(px4)], atol=1e-6)
    assert_allclose(px4.rate, log.rate[: len(px4)], atol=1e-6)
    assert not px4.has_speeds
    with pytest.raises(ValueError, match="has no column 'motor9'"):
        make_log("bad", table, Columns(motors=("motor9", "motor2", "motor3", "motor4")))


def test_a_gap_is_in_no_window(log: FlightLog, tmp_path: Path) -> None:
    table = motors_table(log, tmp_path / "log.csv")
    kept = make_log("gap", table[(table.time < 5.0) | (table.time > 6.0)], Columns())
    windows = windows_of(kept, 0.4, 0.1)
    assert kept.valid[windows.samples].all()
    assert "is in gaps" in kept.gaps()[0]
    assert not log.gaps()
    table.loc[500:520, ["x", "y", "z"]] = table.loc[500, ["x", "y", "z"]].to_numpy()  # as motion capture without sight
    assert_array_equal(np.flatnonzero(~make_log("lost", table, Columns()).valid), np.arange(496, 526))


def test_the_listed_quantities_are_identified_within_five_percent(found: Found) -> None:
    truth = random_vehicle(SEED)[2]
    for name in LISTED:
        assert found.estimates[name].identified, name
        assert found.estimates[name].value == pytest.approx(truth[name], rel=0.05), name


def test_accelerating_rotors_show_their_inertia(found: Found) -> None:
    low, high = found.estimates["rotor_inertia"].interval
    assert low < random_vehicle(SEED)[2]["rotor_inertia"] < high < 2.0 * low


def test_a_hanging_pole_shows_its_length_and_its_drag(hanging: FlightLog, tmp_path: Path) -> None:
    start, truth = random_vehicle(SEED)[1], random_pole(random_vehicle(SEED)[0], SEED)[1]
    found = identify([hanging], start)
    assert found.estimates["pole_length"].value == pytest.approx(truth["pole_length"], rel=0.02)
    low, high = found.estimates["pole_drag_area"].interval
    assert low < truth["pole_drag_area"] < high < 1.5 * low
    training = write_vehicle(found, start, tmp_path / "mine.toml")
    ranges = [scenario.parameters for scenario in find_scenarios([str(training)]).values()]
    assert all(each and each.rod_length for each in ranges)
    pole = as_vehicle(str(tmp_path / "mine.toml")).pole
    assert pole.mass == start.pole.mass
    assert pole.equivalent_length / pole.length == pytest.approx(start.pole.equivalent_length / start.pole.length)
    assert "pole_length 0." in (tmp_path / "mine.toml").read_text()


def test_what_the_log_does_not_show_is_named_with_a_manoeuvre(hanging: FlightLog) -> None:
    log, random = hanging.part(0.0, 0.35), np.random.default_rng(0)
    still = pole_motion(random.normal((0.0, 0.0, -1.0), 0.005, (len(log), 3)), log.period)
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (len(log), 1))
    hover = replace(log, position=0.0 * log.position, velocity=0.0 * log.velocity, quaternion=rest, pole=still)
    noise = random.normal(0.0, 0.02, log.rate.shape)
    hover = replace(hover, rate=noise, motors=np.full_like(log.motors, log.motors.mean()))
    sentences = identify([hover], random_vehicle(SEED)[1]).sentences()
    assert "torque_per_thrust is not identified; fly yaw steps" in sentences
    assert "the order of the motors could not be checked: the flight is gentle" in sentences
    assert not [sentence for sentence in sentences if sentence.startswith("thrust_coefficient")]
    assert "pole_length is not identified; fly swings of the pole" in sentences
    assert "pole_drag_area is not identified; fly fast straight flight to all sides" in sentences


def test_thrusts_do_not_lag_behind_measured_speeds(log: FlightLog) -> None:
    vehicle, windows = without_pole(random_vehicle(SEED)[0]), windows_of(replace(log, measured=True), 0.1, 2.0)
    rotors = vehicle.rotors
    assert rotors is not None
    prompt = replace(vehicle, rotors=replace(rotors, lag_up=0.0))
    assert_array_equal(fly(windows, vehicle, Thrust(4e-8)), fly(windows, prompt, Thrust(4e-8)))
    missing = identify([windows.log], random_vehicle(SEED)[1])
    assert missing.vehicle.rotors.lag_up == pytest.approx(random_vehicle(SEED)[1].rotors.lag_up)  # type: ignore[union-attr]
    assert "lag is not identified; log the commanded speeds" in missing.sentences()


def test_the_identified_vehicle_predicts_the_held_out_part_better_than_its_start(found: Found) -> None:
    start = random_vehicle(SEED)[1]
    errors_of = compare(found.held_out[0], {"start": start, "new": found.vehicle}, delay=found.delay)
    for channel in ("position", "attitude"):
        assert errors_of["new"][channel][-1] < 0.5 * min(errors_of[name][channel][-1] for name in ("start", "held"))


def test_a_log_too_short_to_test_the_vehicle_is_refused_before_the_fit(log: FlightLog) -> None:
    with pytest.raises(ValueError, match=r"0.91 s of the log .* have no 1.5 s without a gap"):
        identify([log.part(0.0, 0.19)], random_vehicle(SEED)[1])


def test_commands_and_a_battery_show_the_thrust(log: FlightLog) -> None:
    start, truth = random_vehicle(SEED)[1:]
    voltage = np.linspace(1.1, 0.85, len(log))
    most = 1.3 * log.motors.max()
    commands = replace(
        log, motors=log.motors / voltage[:, None] / most, voltage=voltage, has_speeds=False, is_command=True
    )
    found = identify([commands], start)
    low, high = found.estimates["voltage_exponent"].interval
    assert low < 2.0 < high < 2.2
    assert found.thrust.linear < 0.05
    assert found.thrust.coefficient == pytest.approx(truth["thrust_coefficient"] * most**2, rel=0.02)
    steady = identify([replace(commands, voltage=np.ones(1))], start)
    assert "voltage_exponent is not identified; log the voltage of the battery" in steady.sentences()


def test_each_log_has_a_trim_of_its_own(log: FlightLog, found: Found) -> None:
    moved = replace(log, motors=log.motors * [1.04, 1.0, 0.98, 1.0])  # the battery lies elsewhere
    both = identify([log, moved], random_vehicle(SEED)[1])
    for name in ("inertia_roll", "inertia_pitch", "thrust_coefficient"):
        assert both.estimates[name].value == pytest.approx(found.estimates[name].value, rel=0.03), name


def test_every_body_that_a_fit_tries_exists() -> None:
    assert_allclose(possible(1.0, 1.2, 1.9), (1.0, 1.2, 1.9))
    for roll, pitch in np.random.default_rng(0).uniform(0.01, 10.0, (100, 2)):
        least, middle, largest = sorted(possible(roll, pitch, 0.7 * (roll + pitch)))
        assert 0.0 < largest < least + middle


def test_motors_that_change_faster_than_the_log_are_said(log: FlightLog, found: Found) -> None:
    assert "means over a row" not in " ".join(found.sentences())
    random = np.random.default_rng(0)
    rough = replace(log, name="rough", motors=log.motors * random.normal(1.0, 0.05, log.motors.shape))
    assert "the motors of rough change much between its rows" in replace(found, fitted=[rough]).sentences()[-1]


def test_what_is_far_from_the_start_is_doubted(found: Found) -> None:
    start = random_vehicle(SEED)[1]
    assert not doubts_of(found, start)
    heavy = replace(start, inertia=tuple(10.0 * np.diag(start.inertia_matrix)))
    assert "inertia_roll is 0.08 times that of" in doubts_of(found, heavy)[0]


def test_thrusts_that_were_not_flown_stay(log: FlightLog) -> None:
    start = random_vehicle(SEED)[1]
    gentle = replace(log, motors=0.8 * log.motors).part(0.0, 0.3)
    assert identify([gentle], start, training=1.0).vehicle.rotors.thrust[1] >= start.rotors.thrust[1]  # type: ignore[union-attr]


def test_nanobench_is_predicted_by_other_flights() -> None:
    """The data are those of Ullah and Baca, see the licence beside them."""
    circle, oval, star = (read_log(path, NANOBENCH) for path in sorted(DATA.glob("*.csv.gz")))
    start = as_vehicle("crazyflie")
    found = identify([star, circle], start, tests=[oval])
    errors_of = compare(
        found.held_out[0],
        {"start": start, "new": found.vehicle},
        delay=found.delay,
        thrusts={"new": found.thrust},
    )
    for channel, share in {"position": 0.5, "attitude": 1.0}.items():
        assert errors_of["new"][channel][20] < share * errors_of["held"][channel][20]
        assert errors_of["new"][channel][25] < 0.4 * errors_of["start"][channel][25]


def test_a_wrong_order_of_motors_or_quaternions_is_said(log: FlightLog) -> None:
    start = random_vehicle(SEED)[1]
    check_log(log, start)
    with pytest.raises(ValueError, match="rotors 1 to 4 turn the body like columns 4, 3, 2, 1 of"):
        check_log(replace(log, motors=log.motors[:, ::-1]), start)
    with pytest.raises(ValueError, match="check the order of the quaternion"):
        check_log(replace(log, quaternion=log.quaternion[:, [1, 2, 3, 0]]), start)
    for seed in range(4):  # motors that explain no turning do not show their order
        check_log(replace(log, motors=np.random.default_rng(seed).normal(1500.0, 50.0, log.motors.shape)), start)


def test_units_and_frames_that_contradict_each_other_are_said(log: FlightLog) -> None:
    check_motion(log)
    turned = log.rotation.inv().apply(log.velocity.copy())
    for velocity in (100.0 * log.velocity, turned):
        with pytest.raises(ValueError, match="must be in m/s and in the world frame"):
            check_motion(replace(log, velocity=velocity))
    with pytest.raises(ValueError, match=r"\(57.* times as large\): check .* rate_unit"):
        check_motion(replace(log, rate=np.degrees(log.rate)))


def test_a_pole_from_its_end_to_the_pivot_is_said(hanging: FlightLog) -> None:
    check_log(hanging, random_vehicle(SEED)[1])
    assert hanging.pole is not None
    with pytest.raises(ValueError, match="leads from the pivot to its centre of mass"):
        check_log(replace(hanging, pole=-hanging.pole), random_vehicle(SEED)[1])


def test_training_takes_the_vehicle_and_its_ranges(found: Found, tmp_path: Path) -> None:
    start: Vehicle = random_vehicle(SEED)[1]
    path = write_vehicle(found, start, tmp_path / "mine.toml")
    again = as_vehicle(str(tmp_path / "mine.toml"))
    assert_allclose(again.inertia_matrix, found.vehicle.inertia_matrix, rtol=1e-3)
    assert again.pole == start.pole
    scenarios = find_scenarios([str(path)])
    assert len(scenarios) == 2  # divides the usual numbers of environments
    for scenario in scenarios.values():
        assert scenario.vehicle == again
        assert scenario.latency == SCENARIOS["flight_breeze"].latency
        assert scenario.observation == SCENARIOS["flight_breeze"].observation
        assert scenario.sensors == SCENARIOS["flight_breeze"].sensors
        assert scenario.parameters is not None
        assert scenario.loop is not None
        assert scenario.loop.rotor_lag is not None


def test_the_command_prints_the_errors_of_each_channel(
    hanging: FlightLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(hanging, tmp_path / "log.csv")
    (tmp_path / "columns.toml").write_text('pole_direction = ["rx", "ry", "rz"]')
    given = ["--columns", str(tmp_path / "columns.toml")]
    main(["replay", str(tmp_path / "log.csv"), "--vehicle", "crazyflie-brushless", *given])
    out = capsys.readouterr().out
    assert "attitude, °" in out
    assert "pole, °" in out


@pytest.mark.parametrize(("package", "suffix"), [("pyulog", ".ulg"), ("orangebox", ".bbl")])
def test_a_missing_reader_is_named_with_its_extra(
    package: str, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(SystemExit):
        main(["replay", str(tmp_path / f"log{suffix}"), "--vehicle", "hummingbird"])
    assert (
        f"this command needs {package}, which is not installed: pip install 'quadpend-gym[logs]'"
        in capsys.readouterr().err
    )
