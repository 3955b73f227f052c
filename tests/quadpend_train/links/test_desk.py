"""A flight on the desk in real time over UDP and MSP; what takes keys, channels and samples does so without waiting."""

import os
import pty
import re
import signal
import socket
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pandas as pd
import pytest

from quadpend_gym.autopilots.firmware import find_binary
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import Scenario, find_scenarios
from quadpend_gym.vehicles import Simulation
from quadpend_train.cli.main import main
from quadpend_train.export.to_c import export_c
from quadpend_train.flight_logs.loop import loop_of
from quadpend_train.flight_logs.merge import merge
from quadpend_train.flight_logs.readers import BETAFLIGHT, read_log
from quadpend_train.flight_logs.replay import compare
from quadpend_train.links import flight, motion_capture
from quadpend_train.links.autopilots import Link, Msp, listen, open_link, parse_address
from quadpend_train.links.desk import PERIOD, Desk
from quadpend_train.links.flight import Operator
from quadpend_train.links.motion_capture import Receiver as Samples
from quadpend_train.links.motion_capture import Sample, pack
from quadpend_train.links.msp import MOTOR, Reader, channels_of, command_of, request, set_raw_rc
from quadpend_train.links.receivers import Receiver
from quadpend_train.links.supervised import FLY, HOLD, KILL, OFF, Supervised
from quadpend_train.links.terminal import END, keys_at_once, pressed
from quadpend_train.links.thrust import ThrustCurve
from quadpend_train.policies.loading import load_policy
from tests.helpers import desk as flights

HOVER = np.array([6.86, 0.0, 0.0, 0.0])
LINEAR, LAG = ThrustCurve((0.0, 1.0), (0.2, 3.8)), 0.015  # of the hummingbird's rotors, s


@pytest.fixture(scope="module")
def breeze() -> Scenario:
    return find_scenarios(["flight_breeze"])["flight_breeze"]


@pytest.fixture(scope="module")
def lqg(tmp_path_factory: pytest.TempPathFactory, breeze: Scenario) -> Path:
    if which("cc") is None:
        pytest.skip("there is no C compiler")
    source = tmp_path_factory.mktemp("lqg") / "policy.c"
    export_c(load_policy("lqg"), "lqg", breeze, source)
    return source


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("", (OFF, False, "")),
        ("hf", (OFF, False, "")),  # not armed
        ("a", (OFF, True, "")),
        ("af", (OFF, True, "")),  # not in the hand
        ("a\n", (KILL, True, r"the key '\n'")),
        ("ah", (HOLD, True, "")),
        ("ahf", (FLY, True, "")),
        ("ahfh", (HOLD, True, "")),
        ("ahfho", (OFF, False, "")),
        ("ahfx", (KILL, True, "the key 'x'")),
        ("ahfo", (KILL, True, "the key 'o'")),  # in the air
        ("ahfq", (KILL, True, "the key 'q'")),
        ("ahfxfh", (KILL, True, "the key 'x'")),  # for ever
    ],
)
def test_keys_are_requests_and_a_key_without_a_meaning_kills(keys: str, expected: tuple[int, bool, str]) -> None:
    operator = Operator()
    for key in keys:
        operator.press(key)
    assert (operator.request, operator.is_armed, operator.cause) == expected
    assert not operator.has_ended


def test_keys_move_the_set_point_end_and_a_closed_terminal_kills() -> None:
    operator = Operator()
    for key in "iiju":
        operator.press(key)
    assert operator.moves.tolist() == [2.0, 1.0, 1.0]
    operator.press(END)
    assert operator.cause == "the terminal is closed"
    ended = Operator()
    ended.press("q")
    assert ended.has_ended


def test_channels_are_the_command_again(breeze: Scenario) -> None:
    given = np.array([8.0, 1.0, -2.0, 0.7])
    channels = channels_of(given, True, breeze.simulation, LINEAR)
    assert command_of(channels, breeze.simulation) == pytest.approx(given, abs=0.015)


def test_a_receiver_arms_at_the_lowest_throttle_and_disarms_without_channels(breeze: Scenario) -> None:
    receiver, now = Receiver(breeze.simulation), 0.0

    def take(command: Floats, is_armed: bool) -> bool:
        receiver.take(set_raw_rc(channels_of(command, is_armed, breeze.simulation, LINEAR)), now, b"")
        return receiver.is_armed

    assert not take(np.zeros(4), True)  # the switch was on before the first message
    assert not take(HOVER, False)
    assert not take(HOVER, True)
    assert not take(np.zeros(4), False)
    assert take(np.zeros(4), True)
    assert take(HOVER, True)
    assert receiver.command == pytest.approx(HOVER, abs=0.01)
    receiver.take(b"", now + 0.05, b"")
    assert receiver.is_armed
    receiver.take(b"", now + 0.07, b"")
    assert not receiver.is_armed
    assert not take(HOVER, True)
    assert not take(np.zeros(4), False)
    replies = Reader().read(receiver.take(request(MOTOR) + set_raw_rc([1500] * 5), now, b"12345678"))
    assert [(reply.command, reply.payload) for reply in replies] == [(MOTOR, b"12345678"), (200, b"")]


def test_a_link_sends_channels_reads_motors_and_notices_its_end(breeze: Scenario) -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    link, receiver = Msp(ours.detach(), breeze.simulation, LINEAR), Receiver(breeze.simulation)
    with theirs:
        for is_armed in (False, True):
            link.send(np.zeros(4), is_armed)
            theirs.sendall(receiver.take(theirs.recv(4096), 0.0, np.full(8, 1250, "<u2").tobytes()))
            assert np.isnan(link.motors()).all() == (not is_armed)
        assert receiver.is_armed
        link.send(HOVER, True)
        assert link.motors().tolist() == [0.25] * 4
        assert 0.0 <= link.silence() < 1.0
    with pytest.raises(OSError, match=r"closed|reset"):
        link.send(HOVER, True)
    link.close()


def test_a_serial_port_is_a_link(breeze: Scenario) -> None:
    autopilot, port = pty.openpty()
    with closing(open_link(f"msp:{os.ttyname(port)}", breeze.simulation, LINEAR)) as link:
        link.send(HOVER, False)
        expected = set_raw_rc(channels_of(HOVER, False, breeze.simulation, LINEAR)) + request(MOTOR)
        assert os.read(autopilot, 4096) == expected
    os.close(autopilot)
    os.close(port)


def own_link(simulation: Simulation) -> Link:
    """A link of a user's own."""
    return Msp(os.dup(0), simulation, LINEAR)


def no_link(simulation: Simulation) -> object:
    return object()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mavlink", "a link must be msp:HOST:PORT, msp:/dev/NAME or module:function, not 'mavlink'"),
        ("msp:host", "an address must be HOST:PORT or PORT, with a port from 1 to 65535, not 'host'"),
        ("msp:127.0.0.1:1", "there is no autopilot at 127.0.0.1:1: "),
        (f"{__name__}:no_link", "must have the method send"),
    ],
)
def test_a_wrong_link_is_refused_in_a_sentence(name: str, message: str, breeze: Scenario) -> None:
    with pytest.raises(ValueError, match=message):
        open_link(name, breeze.simulation, LINEAR)


def test_addresses_and_links_of_ones_own(breeze: Scenario) -> None:
    assert parse_address("9101") == ("127.0.0.1", 9101)
    assert parse_address("10.0.0.2:5761") == ("10.0.0.2", 5761)
    open_link(f"{__name__}:own_link", breeze.simulation, LINEAR).close()


def seen(desk: Desk, steps: int) -> Sample:
    """What motion capture sees after some steps with the motors at hover."""
    for _ in range(steps):
        desk.step(np.zeros(4))
    sample = desk.sample(0.0)
    assert sample is not None
    return sample


def test_a_hand_holds_body_and_pole_and_lets_them_go(breeze: Scenario) -> None:
    desk = Desk(breeze, 0)
    first, later = seen(desk, 1), seen(desk, 500)
    assert first != later  # noise
    assert np.linalg.norm(np.subtract(first.position, later.position)) < 0.01
    assert desk.press("b") == "the hand lets the body go"  # the pole's top is still held
    assert seen(desk, 100).direction[2] > 0.99
    desk.press("p")
    assert any(desk.step(np.zeros(4)) for _ in range(3000))  # an inverted pendulum falls
    assert desk.press("b") == "the hand takes body and pole"
    assert seen(desk, 500).position == pytest.approx(seen(desk, 500).position, abs=0.01)


def test_motion_capture_misses_freezes_and_errs_to_order(breeze: Scenario) -> None:
    desk = Desk(breeze, 0)
    before = seen(desk, 1)
    desk.press("o")
    assert seen(desk, 1).position[0] == pytest.approx(before.position[0] + 1.0, abs=0.01)
    frozen = seen(desk, 1)
    desk.press("z")
    assert seen(desk, 9)[2:] == frozen[2:]
    desk.press("z")
    assert seen(desk, 9)[2:] != frozen[2:]
    desk.press("d")
    assert desk.sample(0.0) is None
    desk.press("d")
    assert seen(desk, 1).counter == 6


def test_a_push_moves_the_body(breeze: Scenario) -> None:
    places = []
    for keys in ("b", "bw"):
        desk = Desk(breeze, 0)
        for key in keys:
            desk.press(key)
        places.append(seen(desk, round(0.3 / PERIOD)).position[0])
    assert places[1] > places[0] + 0.01


def test_the_vehicle_of_a_file_is_that_of_its_header(lqg: Path, tmp_path: Path) -> None:
    for name in ("policy.c", "policy.h"):
        text = (lqg.parent / name).read_text(encoding="utf-8").replace('"hummingbird"', '"crazyflie-brushless-2"')
        (tmp_path / name).write_text(text, encoding="utf-8")
    designed = Supervised(tmp_path / "policy.c").designed
    assert designed == {
        "PERIOD": "0.01",
        "LATENCY": "0.02",
        "INTERFACE": "body_rates",
        "VEHICLE": "crazyflie-brushless-2",
    }


def test_a_log_that_exists_and_a_port_in_use_are_refused(lqg: Path, tmp_path: Path, breeze: Scenario) -> None:
    _, port = flights.free_ports()
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        with pytest.raises(ValueError, match=f"nothing can be received at {port}: "):
            listen(str(port), socket.SOCK_DGRAM)
        sender.sendto(b"sample", source.getsockname())
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        with theirs, pytest.raises(FileExistsError):
            flight.fly(Supervised(lqg), source, Msp(ours.detach(), breeze.simulation, LINEAR), LINEAR, lqg, 0.5)


class Faulty:
    """A link that does not answer, whose motors do not turn, or which is lost after some messages."""

    def __init__(self, fault: str) -> None:
        self.fault, self.is_closed = fault, False
        self.sent: list[tuple[Any, ...]] = []

    def send(self, command: Floats, is_armed: bool) -> None:
        self.sent.append((*command, is_armed))
        if self.fault == "lost" and 30 < len(self.sent) < 40:
            raise OSError("gone")

    def silence(self) -> float:
        return 0.1 if self.fault == "silent" else 0.0

    def motors(self) -> Floats:
        return np.zeros(4) if self.fault == "disarmed" else np.full(4, np.nan)

    def close(self) -> None:
        self.is_closed = True


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("silent", r"the autopilot has not answered for (9\d|100) ms"),  # less what a step was late
        ("disarmed", "the autopilot is not armed"),
        ("lost", r"the link is lost \(gone\): is the autopilot, or the simulation, still running\?"),
    ],
)
def test_faults_of_a_link_kill(
    fault: str, cause: str, lqg: Path, breeze: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, keys = Faulty(fault), iter(["", "a", "h", "f"])
    monkeypatch.setattr(flight, "pressed", lambda: [*next(keys, "")])
    _, port = flights.free_ports()
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        desk = Desk(breeze, 0)
        for _ in range(3):  # that wait for the first steps
            sender.sendto(pack(seen(desk, 1)), source.getsockname())
        summary = flight.fly(Supervised(lqg), source, link, LINEAR, tmp_path / "log.csv", 0.5)
    assert re.fullmatch(cause, summary.cause)
    assert link.is_closed
    assert [sent[-1] for sent in link.sent[-3:]] == [False] * 3
    assert not np.any([sent[:-1] for sent in link.sent[-3:]])
    assert pd.read_csv(tmp_path / "log.csv").cause.iloc[-1] == summary.cause


@pytest.mark.parametrize(
    ("late", "cause"),
    [(0.0, "the autopilot has not answered for 100 ms"), (0.05, ""), (0.08, "a step was late by 80 ms")],
)
def test_a_late_step_is_not_taken_for_a_silent_link(late: float, cause: str, lqg: Path) -> None:
    operator = Operator()
    flight._check(operator, Supervised(lqg), Faulty("silent"), late)
    assert operator.cause == cause


def test_ctrl_s_is_a_key_and_does_not_stop_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, port = pty.openpty()
    with os.fdopen(port) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with keys_at_once():
            os.write(terminal, b"\x13x")
            assert pressed() == ["\x13", "x"]
    os.close(terminal)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, OSError])
def test_an_interruption_and_an_error_disarm_with_messages_in_a_row(
    error: type[BaseException], lqg: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, keys, at = Faulty(""), iter("ah"), []

    def pressed() -> list[str]:
        if not (key := next(keys, "")):
            raise error
        return [key]

    def send(command: Floats, is_armed: bool) -> None:
        at.append((time.monotonic(), is_armed))

    monkeypatch.setattr(flight, "pressed", pressed)
    monkeypatch.setattr(link, "send", send)
    _, port = flights.free_ports()
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"sample", source.getsockname())
        with pytest.raises(error) as raised:
            flight.fly(Supervised(lqg), source, link, LINEAR, tmp_path / "log.csv", 0.5)
    assert error is not KeyboardInterrupt or str(raised.value) == "the autopilot was told to disarm"
    last = at[-4:]
    assert not any(is_armed for _, is_armed in last)
    assert min(np.diff([time for time, _ in last])) >= 0.002
    assert link.is_closed


def test_a_second_process_disarms_if_the_first_one_is_killed(breeze: Scenario) -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    theirs.settimeout(5.0)
    link = Msp(ours.detach(), breeze.simulation, LINEAR)
    if (child := os.fork()) == 0:
        with flight._guarded(link):
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    disarmed = set_raw_rc(channels_of(np.zeros(4), False, breeze.simulation, LINEAR)) + request(MOTOR)
    assert theirs.recv(4096).startswith(disarmed)
    theirs.close()
    link.close()


def test_a_refused_flight_does_not_begin_later(lqg: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link, steps = Faulty(""), iter(range(1000))
    keys = {1: "a", 3: "h", 5: "f", 40: "i", 50: "o", 52: "q"}
    shown: list[str] = []
    monkeypatch.setattr(flight, "_PATIENCE", 10.0)  # of a busy machine
    monkeypatch.setattr(flight, "pressed", lambda: [keys[k]] if (k := next(steps)) in keys else [])
    monkeypatch.setattr(flight, "show", lambda line, _: shown.append(line))
    _, port = flights.free_ports()
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"sample", source.getsockname())  # motion capture sees nothing
        summary = flight.fly(Supervised(lqg), source, link, LINEAR, tmp_path / "log.csv", 0.5)
    assert summary.cause == ""
    assert any("HOLD no flight: BLIND" in line for line in shown)
    assert any("the set point is refused: nothing flies" in line for line in shown)


def test_the_last_of_the_late_steps_gets_the_sample(
    lqg: Path, breeze: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    datagram, steps, (_, port) = pack(seen(Desk(breeze, 0), 1)), iter(range(1000)), flights.free_ports()
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

        def pressed() -> list[str]:
            if (k := next(steps)) == 5:
                sender.sendto(datagram, source.getsockname())
                time.sleep(0.035)
            return ["q"] if k == 15 else []

        monkeypatch.setattr(flight, "pressed", pressed)
        sender.sendto(b"sample", source.getsockname())
        flight.fly(Supervised(lqg), source, Faulty(""), LINEAR, tmp_path / "log.csv", 0.5)
    log = pd.read_csv(tmp_path / "log.csv")
    assert log.late.max() > 0.02
    assert log.late[log.x.notna()].tolist() == [pytest.approx(0.005, abs=0.005)]


def test_set_points_and_flights_have_a_fence_and_what_is_released_must_stay(lqg: Path) -> None:
    policy, place, origin = Supervised(lqg), flight._Place(0.5, 2.0), np.array([1.0, 1.0, 1.0])
    fields = policy.fields

    def cause(before: int, stage: int, position: Floats, *status: str) -> str:
        fields.stage = stage
        return place.cause(before, policy, [*status], position)

    fields.lowest, fields.highest, fields.distance, fields.reference[:3] = 0.0, 2.0, 0.5, [1.0, 1.0, 1.0]
    assert place.refusal(origin, policy) == "nothing flies"
    assert cause(HOLD, FLY, origin) == ""
    assert place.refusal(np.add(origin, [0.5, 0.5, 0.0]), policy) == ""
    assert place.refusal(np.add(origin, [1.0, 0.0, 0.0]), policy) == "the one before is not reached"
    assert place.refusal(np.add(origin, [0.0, 0.0, 2.0]), policy) == "its height"
    fields.reference[:3] = [2.9, 1.0, 1.0]
    assert place.refusal(np.add(origin, [2.1, 0.0, 0.0]), policy) == "it is beyond the fence"
    assert cause(FLY, FLY, np.add(origin, [2.1, 0.0, 0.0]), "BLIND", "OUTLIER") == ""
    assert cause(FLY, FLY, np.add(origin, [2.1, 0.0, 0.0])) == "the vehicle is beyond the fence"
    assert cause(FLY, HOLD, origin) == ""
    assert cause(HOLD, HOLD, np.add(origin, [0.3, 0.0, 0.0])) == ""
    assert cause(HOLD, HOLD, np.add(origin, [0.6, 0.0, 0.0])) == "the vehicle moved after the release"
    assert cause(HOLD, HOLD, origin, "SPEED", "CAUTION") == "SPEED after the release"
    assert cause(HOLD, OFF, origin) == ""
    assert cause(OFF, HOLD, origin, "SPEED") == ""


def test_samples_are_those_of_one_sender_until_it_is_silent_where_nothing_flies(
    breeze: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample, (_, port) = seen(Desk(breeze, 0), 1), flights.free_ports()
    kind = socket.AF_INET, socket.SOCK_DGRAM
    with listen(str(port), socket.SOCK_DGRAM) as source, socket.socket(*kind) as one, socket.socket(*kind) as other:
        receiver = Samples()

        def counters(
            sender: socket.socket, counter: int, may_restart: bool, seconds: float = 0.02
        ) -> tuple[list[int], int]:
            sender.sendto(pack(sample._replace(counter=counter)), source.getsockname())
            found, _ = flight._until(time.monotonic() + seconds, source, receiver, may_restart)
            return [] if found is None else [found.counter], receiver.restarts

        assert counters(one, 7, True) == ([7], 0)
        assert counters(other, 9, True) == ([], 0)
        assert counters(one, 8, True) == ([8], 0)
        monkeypatch.setattr(motion_capture, "_RESTART", 0.0)
        assert counters(other, 0, False) == ([], 0)  # in flight
        assert counters(other, 0, True) == ([0], 1)
        assert counters(one, 9, False) == ([], 1)
        for _ in range(200):  # a flood does not hide a sample
            one.sendto(b"flood", source.getsockname())
        begin = time.monotonic()
        assert counters(other, 1, False, 0.3) == ([1], 1)  # enough for a process that a busy machine stops
        assert time.monotonic() - begin >= 0.3
        assert receiver.foreign == 203


def test_wrong_input_is_one_sentence(lqg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    late_by_nothing, of_own = tmp_path / "late/policy.c", tmp_path / "own/policy.c"
    for path, old, new in (
        (late_by_nothing, "_LATENCY 0.02", "_LATENCY 0.0"),
        (of_own, 'VEHICLE "hummingbird"', 'VEHICLE "mine"'),
    ):
        path.parent.mkdir()
        path.write_text("#error compiled before its header is read", encoding="utf-8")
        text = lqg.with_suffix(".h").read_text(encoding="utf-8").replace(old, new)
        path.with_suffix(".h").write_text(text, encoding="utf-8")
    for arguments, message in {
        ("fly", "none.c", "--to", "msp:1"): "there must be a C file none.c",
        ("fly", str(lqg), "--to", "1"): "a link must be msp:HOST:PORT",
        ("fly", str(lqg), "--to", "msp:1", "--thrust", "t.toml"): "--thrust needs --voltage",
        ("fly", str(lqg), "--to", "msp:1", "--vehicle", "racer"): "was written for the vehicle hummingbird, not",
        ("fly", str(lqg), "--to", "msp:/dev/null"): "/dev/null is no serial port: ",
        (
            "fly",
            str(lqg),
            "--to",
            "msp:1",
            "--height",
            "5",
            "1",
        ): "--height must be the lowest and the highest height, not 5 1",
        ("fly", str(lqg), "--to", "msp:1", "--height", "nan", "1"): "height must be 2 finite numbers from -10000 to",
        ("fly", str(late_by_nothing), "--to", "msp:1"): "was written for no latency, which no flight has: export it",
        ("fly", str(of_own), "--to", "msp:1"): "for the vehicle mine, which is no preset: give its file, such as --v",
        ("simulate", "--blackbox", "flight.bbl"): "--blackbox needs --autopilot betaflight and a new file, not direct",
        ("simulate", "--rate", "150"): "the rate must be 1000 divided by a whole number",
        ("simulate", "--listen", "here"): "an address must be HOST:PORT or PORT",
        ("simulate", "--scenario", '{"vehicle": "hummingbird"}'): "has no sensors: samples without noise count as",
    }.items():
        with pytest.raises(SystemExit) as end:
            main([*arguments])
        assert end.value.code == 2
        assert message in capsys.readouterr().err


def flies_well(flown: flights.Flown) -> bool:
    """Whether a flight to a set point 0.5 m away ended in the hand, near its set points."""
    log = flown.log
    if "Not killed" not in flown.fly or "ended after" not in flown.desk:
        print(flown.fly, flown.desk)
        return False
    last = log[log.stage == "FLY"].tail(50)
    return bool((last.x - last.goal_x).abs().max() < 0.05 and last.goal_x.iloc[0] > 0.45)


def test_a_flight_on_the_desk_ends_in_the_hand_and_its_log_shows_the_loop(
    lqg: Path, tmp_path: Path, breeze: Scenario
) -> None:
    keys = *flights.START, (2.3, "fly", "i"), *flights.later(flights.END, 5.5)
    for seed in range(3):
        flown = flights.fly_on_the_desk(lqg, tmp_path, keys, seed=seed)
        if "Not killed" in flown.fly:
            break
    if "Not killed" not in flown.fly and "no real-time priority" in flown.fly:
        pytest.skip("a busy machine without real-time priority stops a process for longer than a flight bears")
    assert flies_well(flown)
    stages = flown.log.stage[flown.log.stage != flown.log.stage.shift()]
    assert stages.tolist() == ["OFF", "HOLD", "FLY", "HOLD", "OFF"]
    log = read_log(tmp_path / "log.csv", tmp_path / "log.toml")
    assert log.period == pytest.approx(0.01, abs=1e-3)
    assert 5.0 > log.period * len(log) > 4.0  # what flew
    found = compare(log.part(0.3, 1.0), {"hummingbird": breeze.vehicle}, horizon=0.1)  # without the hand
    for name in ("attitude", "rate", "pole"):
        assert found["hummingbird"][name][-1] < found["held"][name][-1]
    loop = loop_of(flown.log, LAG, seconds=(2.3, 5.6))
    assert loop.latency == pytest.approx(0.02, abs=0.003)
    assert loop.time_constant == pytest.approx(0.02, rel=0.2)


EVENTS = {  # who takes which key, and within which time (ms) the motors stop: without and with the firmware
    "frozen": ("desk", "z", 100.0, 100.0),
    "lost link": ("desk", "l", 100.0, np.nan),
    "killed companion": ("fly", "KILL", 50.0, 50.0),
    "key": ("fly", "x", 30.0, 30.0),
    "lost motion capture": ("desk", "d", 200.0, 200.0),
}


def autopilot_or_skip(name: str) -> str:
    """The name of an autopilot, if it is installed."""
    if name == "betaflight":
        try:
            find_binary(os.environ.get("BETAFLIGHT_SITL"))
        except FileNotFoundError as error:
            pytest.skip(str(error))
    return name


@pytest.mark.extras
@pytest.mark.parametrize("autopilot", ["direct", "betaflight"])
@pytest.mark.parametrize("event", EVENTS)
def test_a_lost_part_ends_in_the_kill_in_ten_of_ten(event: str, autopilot: str, lqg: Path, tmp_path: Path) -> None:
    (who, key, *most), found = EVENTS[event], []
    limit = most[autopilot_or_skip(autopilot) == "betaflight"]
    if np.isnan(limit):
        pytest.skip("the firmware's own port cannot be made silent")
    for seed in range(10):
        keys = flights.later((*flights.START, (2.6 + 0.013 * seed, who, key)), 1.0)
        flown = flights.fly_on_the_desk(lqg, tmp_path, keys, seed=seed, autopilot=autopilot)
        of_key = flown.ordered("p") + flown.pressed[key] - flown.pressed["p"]
        found.append(1e3 * (flown.disarmed - (of_key if who == "fly" else flown.ordered(key))))
    print(f"{event}, {autopilot}: motors off after {min(found):.0f} to {max(found):.0f} ms")
    assert min(found) >= -2.0
    assert max(found) < limit


@pytest.mark.extras
@pytest.mark.parametrize("autopilot", ["direct", "betaflight"])
def test_nine_of_ten_flights_with_drop_outs_each_second_end_in_the_hand(
    autopilot: str, lqg: Path, tmp_path: Path
) -> None:
    keys = *flights.START, (3.0, "fly", "i"), (6.0, "fly", "j"), *flights.later(flights.END, 10.0)
    good = 0
    autopilot_or_skip(autopilot)
    for seed in range(10):
        flown = flights.fly_on_the_desk(
            lqg, tmp_path, flights.later(keys, 1.0), "event_dropouts", seed, autopilot=autopilot
        )
        good += flies_well(flown)
        print(autopilot, seed, *flown.fly.splitlines()[-5:-1], flown.desk.splitlines()[-1], sep="\n  ")
    assert good >= 9


@pytest.mark.extras
def test_the_blackbox_of_the_firmware_merges_with_the_log_and_shows_the_vehicle(
    lqg: Path, tmp_path: Path, breeze: Scenario
) -> None:
    pytest.importorskip("orangebox")
    autopilot_or_skip("betaflight")
    keys = *flights.START, (3.0, "fly", "i"), (6.0, "fly", "j"), *flights.later(flights.END, 9.0)
    file, later = tmp_path / "flight.bbl", flights.later(keys, 1.0)
    flown = flights.fly_on_the_desk(lqg, tmp_path, later, autopilot="betaflight", more=("--blackbox", str(file)))
    motors = "motor[0]", "motor[1]", "motor[2]", "motor[3]"
    blackbox = read_log(file, replace(BETAFLIGHT, motors=motors, motor_unit="1", measured=False, poles=1))
    thrusts = LINEAR.thrust((blackbox.motors - 1000.0) / 1000.0)
    found = merge(
        read_log(tmp_path / "log.csv", tmp_path / "log.toml"),
        replace(blackbox, motors=np.sqrt(thrusts), is_command=False),
    )
    assert found.correlation > 0.95
    errors = compare(found.log.part(0.15, 0.95), {"hummingbird": breeze.vehicle}, horizon=0.1)
    for name in ("position", "velocity", "attitude", "rate"):
        assert errors["hummingbird"][name][-1] < errors["held"][name][-1]
    loop = loop_of(flown.log, LAG, seconds=(3.5, 10.0))
    assert loop.latency == pytest.approx(0.02, abs=0.003)
    assert loop.time_constant == pytest.approx(0.02, rel=0.2)
