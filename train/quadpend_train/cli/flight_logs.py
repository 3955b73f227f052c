"""The commands about flight logs: `replay` and `identify`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from quadpend_gym.core.settings import Range

if TYPE_CHECKING:
    from quadpend_train.flight_logs.log import FlightLog

Seconds = Annotated[float, Range(0.05, 10.0, "s")]


def _read(
    paths: Sequence[Path],
    columns: Path | None,
    blackbox: Sequence[Path] = (),
    blackbox_columns: Path | None = None,
) -> "list[FlightLog]":
    """Return logs, with motors and gyro of the blackboxes of the same flights if there are any."""
    from quadpend_train.flight_logs.merge import merge
    from quadpend_train.flight_logs.readers import read_log, read_logs

    logs = [log for path in paths for log in read_logs(path, columns)]
    if len(blackbox) not in (0, len(logs)):
        raise ValueError(f"--blackbox must be as many files as there are logs, {len(logs)}, not {len(blackbox)}")
    for i, path in enumerate(blackbox):
        found = merge(logs[i], read_log(path, blackbox_columns))
        logs[i] = found.log
        print(f"{found.sentence(path.name)}.")
    return logs


def replay(
    log: tyro.conf.Positional[Path],
    vehicle: tuple[str, ...],
    columns: Path | None = None,
    horizon: Seconds = 0.5,
    delay: Annotated[float, Range(-1.0, 1.0, "s")] = 0.0,
    blackbox: tuple[Path, ...] = (),
    blackbox_columns: Path | None = None,
) -> None:
    """Fly vehicles open loop under the motor commands of a flight log, and compare them with the log.

    Args:
        log: Flight log: a CSV file, a PX4 log (.ulg) or a Betaflight log (.bbl, .bfl).
        vehicle: Vehicles: presets or TOML files.
        columns: TOML file with the names and units of the log's columns.
        horizon: Length of the windows, s.
        delay: Time by which the log of the motion is later than that of the motors, s; identify prints it.
        blackbox: Betaflight log of the same flight, whose motors and gyro replace those of the log.
        blackbox_columns: As columns, for the blackbox.
    """
    from quadpend_gym.vehicles.vehicle import as_vehicle
    from quadpend_train.flight_logs.identify import check_motion
    from quadpend_train.flight_logs.replay import compare, table

    for read in _read([log], columns, blackbox, blackbox_columns):
        check_motion(read)
        print(f"{read.name}:")
        print(table(compare(read, {name: as_vehicle(name) for name in vehicle}, horizon, delay)))
        for sentence in read.gaps():
            print(f"Note: {sentence}.")


def identify(
    logs: tyro.conf.Positional[tuple[Path, ...]],
    vehicle: str,
    columns: Path | None = None,
    test: tuple[Path, ...] = (),
    out: Path = Path("vehicle.toml"),
    loop: bool = False,
    blackbox: tuple[Path, ...] = (),
    blackbox_columns: Path | None = None,
) -> None:
    """Identify a vehicle from flight logs, and write its file and scenarios for training.

    Args:
        logs: Flight logs of one vehicle, as in replay, without a pole or with its direction.
        vehicle: Vehicle with the true masses, rotor positions and pivot, a preset or TOML file; the fit begins with it.
        columns: TOML file with the names and units of the logs' columns.
        test: Further logs to test the vehicle on. Without them, it is tested on the last 30 % of each log.
        out: Vehicle file. The scenarios are beside it, in NAME-training.toml.
        loop: Print the latency and the time constant of the rate loop instead, from logs of `quadpend fly`; the lag of
            the rotors is that of the vehicle.
        blackbox: Betaflight log of each flight, as in replay.
        blackbox_columns: As columns, for the blackboxes.
    """
    from quadpend_gym.vehicles import Simulation, doubts, rotors_of
    from quadpend_gym.vehicles.vehicle import as_vehicle
    from quadpend_train.flight_logs.identify import doubts_of
    from quadpend_train.flight_logs.identify import identify as identify_from
    from quadpend_train.flight_logs.log import DEFAULT
    from quadpend_train.flight_logs.loop import loop_of
    from quadpend_train.flight_logs.readers import as_columns, read_csv
    from quadpend_train.flight_logs.replay import compare, table
    from quadpend_train.flight_logs.vehicle_file import SETTINGS, write_vehicle

    start = as_vehicle(vehicle)
    if loop:
        if blackbox:
            raise ValueError("--loop reads the logs of `quadpend fly` alone: leave --blackbox out")
        for path in logs:
            seconds = as_columns(columns, DEFAULT).seconds
            found_loop = loop_of(read_csv(path), 0.5 * sum(rotors_of(start).lags), seconds, path.stem)
            print(f"{path}: {found_loop.sentence()}.")
        return
    fitted, tests = _read(logs, columns, blackbox, blackbox_columns), _read(test, columns)
    found = identify_from(fitted, start, tests=tests)
    print(found.table())
    for log in found.held_out:
        print(f"\n{'' if test else 'The held-out part of '}{log.name}:")
        both = {start.name: start, "identified": found.vehicle}
        print(table(compare(log, both, delay=found.delay, thrusts={"identified": found.thrust})))
    gaps = [sentence for log in (*fitted, *tests) for sentence in log.gaps()]
    doubtful = *doubts_of(found, start), *doubts(Simulation(vehicle=found.vehicle, interface="body_rates"))
    print("", *(f"Note: {sentence}." for sentence in (*gaps, *found.sentences(), *doubtful)), sep="\n")
    training = write_vehicle(found, start, out)
    print(f"Written: {out} and {training}")
    print(f"Train: quadpend train --settings {SETTINGS} --scenarios {training} --out runs/{out.stem}")
