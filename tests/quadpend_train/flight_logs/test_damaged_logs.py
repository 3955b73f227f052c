"""Logs from elsewhere are read right, or refused with one sentence that names the log and what is wrong."""

import gzip
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quadpend_gym.core.files import read_toml
from quadpend_train.flight_logs import readers
from quadpend_train.flight_logs.log import DEFAULT, Columns, make_log
from quadpend_train.flight_logs.readers import BETAFLIGHT, THROTTLES, read_log, read_logs
from tests.quadpend_train.cli.test_commands import refused

ROWS = 300


@cache
def whole() -> pd.DataFrame:
    """A log of 3 s whose numbers all differ."""
    time = 0.01 * np.arange(ROWS)
    waves = np.sin(np.outer(time, np.linspace(1.0, 3.0, 13)))
    turns = Rotation.from_rotvec(0.3 * waves[:, :3]).as_quat(scalar_first=True)
    motors = [f"motor{i}" for i in range(1, 5)]
    names = ["time", *"xyz", "vx", "vy", "vz", "wx", "wy", "wz", *motors, "qw", "qx", "qy", "qz"]
    return pd.DataFrame(
        np.column_stack([time, waves[:, :9], 1500.0 + 9.0 * waves[:, 9:], turns]).round(6), columns=names
    )


def csv(change: Callable[[pd.DataFrame], pd.DataFrame] = lambda table: table, **options: Any) -> bytes:
    """The log as CSV, changed by a function and by the options of pandas."""
    return str(change(whole()).to_csv(**{"index": False, **options})).encode()


def at(column: str, value: object, row: int | None = None) -> bytes:
    """The log with another value of a column in one row, counted from zero, or in all."""
    return csv(lambda t: t.assign(**{column: t[column].astype(object).mask((t.index == row) | (row is None), value)}))


def stamps(change: Callable[[Any], Any]) -> bytes:
    """The log with other time stamps."""
    return csv(lambda table: table.assign(time=change(table.time.to_numpy())))


TEXT = csv()
HEAD, BODY = TEXT.split(b"\n", 1)
READ = {  # files that say the same in another form
    "trailing comma": BODY.replace(b"\n", b",\n").join([HEAD + b"\n", b""]),
    "trailing comma everywhere": TEXT.replace(b"\n", b",\n"),
    "byte order mark": b"\xef\xbb\xbf" + TEXT,
    "CRLF": TEXT.replace(b"\n", b"\r\n"),
    "spaces": b" " + TEXT.replace(b",", b" , "),
    "quoted": csv(quoting=1),
    "other column twice": b"a,a," + TEXT.replace(b"\n", b"\n0,0,").rstrip(b",0"),
    "text in another column": csv(lambda table: table.assign(mode="OFFBOARD")),
    "large time": stamps(lambda time: time + 1.7e9),
    "rows twice": csv(lambda table: pd.concat([table, table[100:200]]).sort_values("time")),
    "wraps at 2^32 us": stamps(lambda time: ((time + 4293.5) * 1e6).round() % 2**32 / 1e6),
    "wraps at 2^32 ms": stamps(lambda time: ((time + 4294966.0) * 1e3).round() % 2**32 / 1e3),
    "wraps at 2^16 ms": stamps(lambda time: ((time + 64.0) * 1e3).round() % 2**16 / 1e3),
    "wraps below zero": stamps(lambda time: ((time + 2146.0) * 1e6).round().astype(np.int64).astype(np.int32) / 1e6),
}
WITHOUT = {  # files without one complete row
    "first stamp": (at("time", np.nan, 0), 0),
    "end of the last row": (TEXT[:-30], 299),
    "cell": (at("motor2", np.nan, 7), 7),
    "no attitude": (at("qw", 0.0, 7), 7),
    "a spike of a motor": (at("motor2", 9e4, 7), 7),
    "a spike of the gyro": (at("wy", 40.0, 7), 7),
}
REFUSED = {
    "empty": (b"", "No columns"),
    "names alone": (
        HEAD,
        "ten complete rows.* not 0 with 0 time stamps in seconds 0 to 1e.09; its column 'time' has 0",
    ),
    "one row": (csv(lambda table: table[:1]), "not 1 with"),
    "ten rows": (csv(lambda table: table[:10]), "longer than 0.1 s"),
    "no names": (BODY, "no column 'time'; name its columns, which are '0.0'"),
    "no motor4": (csv(lambda table: table.drop(columns="motor4")), "no column 'motor4' .*motor"),
    "x twice": (TEXT.replace(b",y,", b",x,"), "two columns 'x'"),
    "semicolons": (csv(sep=";"), "no column 'time'.* 'time;x;y"),
    "decimal commas": (HEAD + b"\n" + BODY.replace(b".", b","), "rows of as many numbers"),
    "one long row": (
        TEXT.replace(b"\n", b",7\n", 9).replace(b",7\n", b"\n", 8),
        "Expected 18 fields in line 9, saw 19",
    ),
    "comment first": (b"# hover, 2 minutes\n" + TEXT, "rows of as many numbers"),
    "UTF-16": (TEXT.decode().encode("utf-16"), "UTF-8.*codec"),
    "latin-1": ("höhe,".encode("latin-1") + TEXT, "UTF-8.*codec"),
    "text": (at("x", "lost", 6), "'lost' in column 'x' of row 7"),
    "zero bytes at the end": (TEXT + b"\0" * 50, "zero bytes in row 301; cut it there"),
    "inf": (at("x", np.inf, 6), "'inf' in column 'x' of row 7"),
    "huge": (at("motor2", 1e300, 6), r"'1e\+300' in column 'motor2' of row 7"),
    "empty column": (at("vz", np.nan), "column 'vz' has 0 numbers"),
    "no stamps": (at("time", np.nan), "column 'time' has 0 numbers"),
    "dates": (
        stamps(lambda time: pd.Timestamp("2026-01-01") + pd.to_timedelta(time, "s")),
        "'2026-01-01.*'time' of row 1",
    ),
    "same stamp": (at("time", 5.0), "300 with 1 time stamp"),
    "milliseconds": (stamps(lambda time: time * 1e3), "every 10 s; check its time_unit, which is 's'"),
    "backwards": (csv(lambda table: table[::-1]), "row 2 goes back from 2.99 to 2.98 s"),
    "goes back often": (stamps(lambda time: time % 0.3), "row 31 goes back from 0.29 to 0 s; split"),
    "a far stamp": (at("time", 1e8, 299), "nearly all gap.* to 100000000 s"),
    "scaled quaternions": (csv(lambda table: table.assign(qw=1e4 * table.qw)), "norm 1, not 1e.04"),
    "a motor at rest": (at("motor3", 0.0), "its motor 'motor3' never turns"),
    "millimetres": (
        csv(lambda table: table.assign(**{name: 1e3 * table[name] for name in ("x", "y", "z", "vx", "vy", "vz")})),
        "positions that jump by more than 0.5 m in [0-9]+% of its rows: check their unit, m",
    ),
    "no motion": (csv(lambda table: table.assign(x=0.0, y=0.0, z=1.0)), "its position hardly changes"),
    "cut gzip": (gzip.compress(TEXT)[:-99], "rows of as many numbers"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9, "cannot be read"),
}
SUFFIX = {"cut gzip": ".csv.gz"}


@pytest.mark.parametrize("case", READ)
def test_other_forms_of_a_csv_file_have_the_same_log(case: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(READ[case])
    log, expected = read_log(tmp_path / "log.csv"), make_log("log", whole(), DEFAULT)
    assert len(log) == len(expected) == ROWS
    for name in ("position", "velocity", "quaternion", "rate", "motors"):
        assert_allclose(getattr(log, name), getattr(expected, name), atol=1e-3, err_msg=name)  # µs of 1.7e9 s


@pytest.mark.parametrize("case", WITHOUT)
def test_incomplete_rows_are_left_out(case: str, tmp_path: Path) -> None:
    content, row = WITHOUT[case]
    (tmp_path / "log.csv").write_bytes(content)
    expected = make_log("log", whole().drop(row), DEFAULT)
    assert_allclose(read_log(tmp_path / "log.csv").position, expected.position, atol=1e-9)


@pytest.mark.parametrize("case", REFUSED)
def test_damaged_csv_files_are_refused_in_one_sentence(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, pattern = REFUSED[case]
    path = tmp_path / f"my_log{SUFFIX.get(case, '.csv')}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=pattern) as caught:
        read_log(path)
    assert "my_log" in str(caught.value)
    assert "my_log" in refused(["replay", str(path), "--vehicle", "hummingbird"], capsys)


def test_a_file_may_have_several_flights(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(TEXT + BODY)
    first, second = read_logs(tmp_path / "log.csv")
    assert (first.name, second.name) == ("log-1", "log-2")
    assert_allclose(first.position, second.position)
    with pytest.raises(ValueError, match="has 2 flights"):
        read_log(tmp_path / "log.csv")


def test_a_table_of_columns_serves_flights_with_and_without_a_pole() -> None:
    columns = Columns(pole_direction=("rx", "ry", "rz"))
    assert make_log("bare", whole(), columns).pole is None
    assert make_log("pole", whole().assign(rx=0.0, ry=0.0, rz=1.0), columns).pole is not None
    with pytest.raises(ValueError, match="no column 'rz'"):
        make_log("torn", whole().assign(rx=0.0, ry=0.0), columns)


def test_a_column_has_one_meaning() -> None:
    with pytest.raises(ValueError, match="columns must name 'm1' once"):
        Columns(motors=("m1", "m2", "m1", "m4"))


def test_the_grid_ends_at_the_last_stamp() -> None:
    for first in np.arange(0.0, 20.0, 0.05):
        table = whole().assign(time=(first + 0.01 * np.arange(ROWS)).round(6))
        log = make_log("log", table, DEFAULT)
        assert len(log) == ROWS
        assert_allclose(log.position[-1], table[["x", "y", "z"]].iloc[-1])


def test_positions_may_be_northings_of_utm() -> None:
    log = make_log("log", whole().assign(y=lambda table: table.y + 5e6), DEFAULT)
    assert_allclose(log.position[:, 1] - 5e6, whole().y, atol=1e-6)


def test_no_window_contains_a_jump_of_the_position() -> None:
    jumped = whole().assign(x=lambda table: table.x + 3.0 * (table.index >= 150))
    for columns in (DEFAULT, Columns()):  # Columns(): velocities are derivatives of the position
        assert_array_equal(np.flatnonzero(~make_log("log", jumped, columns).valid), np.arange(145, 155))
    assert make_log("log", whole(), DEFAULT).valid.all()


def lost(table: pd.DataFrame, rows: slice, names: list[str]) -> pd.DataFrame:
    """The log whose columns run straight on, as from a table of topics of which one was lost."""
    table = table.copy()
    begin = table.loc[rows.start, names].to_numpy(float)
    slope = begin - table.loc[rows.start - 1, names].to_numpy(float)
    table.loc[rows, names] = begin + slope * np.arange(rows.stop - rows.start + 1)[:, np.newaxis]
    return table


@pytest.mark.parametrize("names", [DEFAULT.motors, DEFAULT.rate, DEFAULT.position])
def test_a_topic_without_samples_is_a_gap(names: tuple[str, ...]) -> None:
    inside = make_log("log", lost(whole(), slice(140, 160), list(names)), DEFAULT)
    assert not inside.valid[140:161].any()
    assert inside.valid[:130].all()
    end = make_log("log", lost(whole(), slice(250, 299), list(names)), DEFAULT)
    assert 240 < len(end) <= 250
    assert "at the ends of the log log show no flight" in end.gaps()[0]


def test_each_topic_may_have_rows_of_its_own() -> None:
    topics = [DEFAULT.motors, DEFAULT.rate or (), ("x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz")]
    parts = [whole()[["time", *names]].assign(time=whole().time + 0.003 * i) for i, names in enumerate(topics)]
    log = make_log("topics", pd.concat(parts).sort_values("time", ignore_index=True), DEFAULT)
    expected = make_log("log", whole(), DEFAULT)
    assert len(log) == pytest.approx(ROWS, abs=1)
    assert_allclose(log.position[:-1], expected.position[: len(log) - 1], atol=1e-6)
    assert_allclose(log.motors[:-1], expected.motors[: len(log) - 1], atol=0.3)  # 6 ms earlier
    assert log.valid.all()
    assert "empty cells of the log topics are interpolated, at the times of qw" in log.gaps()


def test_what_no_vehicle_does_is_left_out_and_named() -> None:
    table = whole().astype({"motor1": float})
    table.loc[7, "motor2"] = 9e4
    table.loc[90, "wy"] = 40.0
    table.loc[200, ["qw", "qx", "qy", "qz"]] = 0.0
    notes = " ".join(make_log("log", table, DEFAULT).gaps())
    assert "1 rows of the log log with a motor out of its range are left out" in notes
    assert "with a spike of the body rate" in notes
    assert "with no attitude" in notes


def test_the_rest_and_a_crash_are_no_flight() -> None:
    time = 0.01 * np.arange(200)
    rest = pd.concat([whole()[:1]] * 200).assign(time=time)
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (200, 3))
    rest[["x", "y", "z"]] += noise
    rest[["wx", "wy", "wz"]] += noise
    rest[["motor1", "motor2", "motor3"]] += 1e3 * noise
    flown = pd.concat([rest, whole().assign(time=whole().time + 2.0)])
    assert len(make_log("log", flown, DEFAULT)) == pytest.approx(ROWS, abs=30)
    fallen = whole().copy()
    turned = Rotation.from_rotvec([2.0, 0.0, 0.0]) * Rotation.from_quat(
        fallen[["qw", "qx", "qy", "qz"]], scalar_first=True
    )
    fallen.loc[250:, ["qw", "qx", "qy", "qz"]] = turned.as_quat(scalar_first=True)[250:]
    assert len(make_log("log", fallen, DEFAULT)) == pytest.approx(200, abs=10)


def test_a_table_of_columns_replaces_some_of_a_formats_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    down = whole() * np.where(whole().columns.isin(["y", "z", "vy", "vz", "qy", "qz", "wy", "wz"]), -1.0, 1.0)
    renamed = down.assign(time=1e6 * down.time).rename(columns={"motor1": "left"})
    monkeypatch.setattr(readers, "_px4", lambda path: renamed)
    (tmp_path / "columns.toml").write_text('motors = ["left", "motor2", "motor3", "motor4"]\nmotor_unit = "rad/s"')
    log = read_log(tmp_path / "log.ulg", tmp_path / "columns.toml")
    assert_allclose(log.position, whole()[["x", "y", "z"]], atol=1e-6)
    assert_allclose(log.motors, whole()[list(DEFAULT.motors)], atol=1e-6)


def test_betaflight_without_speeds_has_throttles(monkeypatch: pytest.MonkeyPatch) -> None:
    table = whole().assign(time=1e6 * whole().time)
    names = dict(zip(("wx", "wy", "wz"), BETAFLIGHT.rate or (), strict=True))
    names |= dict(zip(DEFAULT.motors, THROTTLES.motors, strict=True))
    table[list(DEFAULT.motors)] /= 2000.0
    monkeypatch.setattr(readers, "_betaflight", lambda path: table.rename(columns=names))
    log = read_log("log.bbl")
    assert log.is_command
    assert not log.has_speeds
    assert_allclose(log.motors, table[list(DEFAULT.motors)], atol=1e-6)


def test_a_log_in_microseconds_is_read_whole_if_its_counter_wraps(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(stamps(lambda time: ((time + 4293.5) * 1e6).round() % 2**32))
    log = read_log(tmp_path / "log.csv", Columns(time_unit="us"))
    assert_allclose(log.position, whole()[["x", "y", "z"]], atol=1e-6)


@pytest.mark.parametrize(
    ("package", "file", "begins"),
    [("pyulog", "my_log.ulg", b"ULog\x01\x12\x35\x01"), ("orangebox", "my_log.bbl", b"H Product:Blackbox\nH a:b\nI")],
)
def test_damaged_logs_of_firmwares_are_refused_in_one_sentence(
    package: str, file: str, begins: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(package)
    for content in (b"", b"hover\n", b"\x89PNG" + bytes(range(256)), begins, begins + bytes(99)):
        (tmp_path / file).write_bytes(content)
        sentence = refused(["replay", str(tmp_path / file), "--vehicle", "hummingbird"], capsys)
        assert f"{file}' cannot be read as a " in sentence


def test_a_settings_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "columns.toml").write_text("time = 't'", encoding="utf-8-sig")
    assert read_toml(tmp_path / "columns.toml") == {"time": "t"}
