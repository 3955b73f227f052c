"""A flight: samples of motion capture in, the supervised policy at its rate, commands out, a log.

Every step has an absolute deadline. Their rate is that of the policy, and their phase follows the samples: a step comes
`_LEAD` after the arrival of a sample. A step that is late is made up for at once, since policies predict by their
period. The operator's keys are requests; the stage is that of the supervisor.
"""

import csv
import gc
import os
import select
import signal
import socket
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.links.autopilots import Link
from quadpend_train.links.motion_capture import SIZE, Receiver, Sample
from quadpend_train.links.supervised import FLY, HOLD, KILL, OFF, STAGES, Supervised
from quadpend_train.links.terminal import END, pressed, show
from quadpend_train.links.thrust import ThrustCurve

_LEAD = 0.002  # s, from the arrival of a sample to the step that uses it
_FOLLOW, _FASTEST = 0.05, 0.02  # share of a wrong phase that a step corrects, and the most, as a share of the period
_CLOCKS = 1e-4  # s/s, by which the sender's clock may drift
_PATIENCE, _FROZEN = 0.06, 0.055  # s, that the link may be silent or a step late, and that samples may be frozen
_MOST = 100  # datagrams after the deadline of a step: a flood must not stop it
_FIRST = 10.0  # s, to wait for the first sample
_SHOWN = 0.2  # s, between two lines of the terminal
_AFTER_KILL = 0.3  # s, for which a kill is repeated
_REPEATS, _REPEATED = 10, 0.002  # at once, at these times (s): Betaflight disarms after four messages in a row
_ASKED = 0.2  # s, for which a flight may be refused until the request is dropped
_AHEAD = 1.5  # steps from the reference to a set point, at most
_RELEASED = {"AGE", "HEIGHT", "SPEED", "BODY_TILT", "POLE_TILT"}  # kill in HOLD after a flight too

KEYS = {  # request, and whether it is armed
    "a": (OFF, True),
    "h": (HOLD, True),
    "f": (FLY, True),
    "o": (OFF, False),
}
MOVES = {  # of the set point along x, y, z
    "i": (1, 0, 0),
    "k": (-1, 0, 0),
    "j": (0, 1, 0),
    "l": (0, -1, 0),
    "u": (0, 0, 1),
    "m": (0, 0, -1),
}
HELP = (
    "a arm   h hold (in the hand)   f fly   o disarm   q end   set point: i k forward back, j l left right, u m up down"
    "   any other key: KILL"
)
IDENTIFIED = """# Columns of {log} for `quadpend identify` and `quadpend replay`
motors = ["thrust1", "thrust2", "thrust3", "thrust4"]  # put them in the order of your vehicle's rotors
motor_unit = "N"
pole_direction = ["rx", "ry", "rz"]
seconds = [{begin:.2f}, {end:.2f}]  # of the longest flight; cut what was in the hand
"""
COLUMNS = (
    *("time", "x", "y", "z", "qw", "qx", "qy", "qz", "rx", "ry", "rz", "motor1", "motor2", "motor3", "motor4"),
    *("thrust1", "thrust2", "thrust3", "thrust4"),  # N, of the rotors at these outputs of the motors
    *("thrust", "rate_x", "rate_y", "rate_z", "goal_x", "goal_y", "goal_z"),
    *("exposure", "late", "silence", "stage", "status", "cause"),
)


@dataclass
class Operator:
    """What the operator asks for. Arming comes first; a key without a meaning kills, and so does a closed terminal."""

    request: int = OFF
    is_armed: bool = False
    cause: str = ""  # of a kill
    note: str = ""  # what was refused, until the next key
    has_ended: bool = False
    moves: Floats = field(default_factory=lambda: np.zeros(3))

    def kill(self, cause: str) -> None:
        """Request the kill, for ever; the first cause stays."""
        self.request, self.cause = KILL, self.cause or cause

    def press(self, key: str) -> None:
        """Take a key."""
        request, is_armed = KEYS.get(key, (KILL, False))
        self.note = ""
        if key == END:
            self.kill("the terminal is closed")
        elif key == "q" and not self.is_armed:
            self.has_ended = True
        elif key in MOVES:
            self.moves += MOVES[key]
        elif request == KILL or self.request == KILL or (request == OFF and self.request == FLY):
            self.kill(f"the key {key!r}")
        elif request == FLY and self.request not in (HOLD, FLY):
            self.note = "f comes after h"
        elif self.is_armed or request == OFF:
            self.request, self.is_armed = request, is_armed


class Summary(NamedTuple):
    """What a flight was like."""

    cause: str  # of the kill; empty: there was none
    late: Floats  # of each step after its deadline, s
    delays: Floats  # of commands after the exposure of their sample by the sender's clock, s
    receiver: Receiver  # with what was lost, late or foreign
    flown: tuple[float, float]  # begin and end of the longest flight, s from the first row of the log

    def sentences(self) -> list[str]:
        """Return the figures of the flight."""
        usual, worst = 1e3 * np.quantile(self.late, 0.99), 1e3 * self.late.max()
        found = [
            f"{len(self.late)} steps, late by at most {usual:.2f} ms in 99 % of them and by {worst:.2f} ms in all",
            f"{self.receiver.lost} samples were lost, {self.receiver.late} came late or twice, and"
            f" {self.receiver.foreign} datagrams were foreign",
        ]
        if len(self.delays) and 0.0 < (median := float(np.median(self.delays))) < 1.0:  # the clocks are the same
            most = 1e3 * np.quantile(self.delays, 0.99)
            found.append(f"Commands left {1e3 * median:.1f} ms after the exposure (median; 99 %: {most:.1f} ms)")
        return [*found, f"Killed: {self.cause}" if self.cause else "Not killed"]


def _until(
    deadline: float, source: socket.socket, receiver: Receiver, may_restart: bool
) -> tuple[Sample | None, float]:
    """Return the newest sample that arrives until a deadline, and when it arrived; None: there is none."""
    found, arrived, left = None, 0.0, _MOST
    while left and select.select([source], [], [], max(deadline - time.monotonic(), 0.0))[0]:
        with suppress(BlockingIOError):
            datagram, sender = source.recvfrom(SIZE + 1)
            now = time.monotonic()
            left -= now > deadline
            if sample := receiver.take(datagram, sender, now, may_restart):
                found, arrived = sample, now
    return found, arrived


def fly(
    policy: Supervised,
    source: socket.socket,
    link: Link,
    curve: ThrustCurve,
    path: Path,
    step: float,
    fence: float = 2.0,
) -> Summary:
    """Fly until the operator ends or a kill.

    Args:
        policy: What flies, with its limits.
        source: Of samples, a socket that does not block.
        link: To the autopilot; it is closed at the end.
        curve: Thrust of a rotor at the outputs of the motors, for the log.
        path: Of the log, a new CSV file with `COLUMNS`.
        step: Distance by which a key moves the set point, m.
        fence: Horizontal distance from where the flight began that kills, m.
    """
    if not select.select([source], [], [], _FIRST)[0]:
        raise ValueError(f"no sample arrives at port {source.getsockname()[1]} within {_FIRST:g} s")
    operator = Operator()
    gc.collect()
    gc.disable()  # its pauses are longer than a step
    try:
        with _guarded(link), path.open("x", newline="", encoding="utf-8", buffering=1) as file:
            return _fly(policy, source, link, curve, csv.writer(file), _Place(step, fence), operator)
    except KeyboardInterrupt as interruption:
        interruption.args = ("the autopilot was told to disarm",)
        raise
    finally:
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
        gc.enable()
        _disarm(link)
        link.close()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))


def _disarm(link: Link) -> None:
    for _ in range(_REPEATS):
        with suppress(Exception):
            link.send(np.zeros(4), False)
        time.sleep(_REPEATED)


@contextmanager
def _guarded(link: Link) -> Iterator[None]:
    """Let a second process disarm at once if this one is killed: the failsafe of the autopilot takes longer."""
    ours, theirs = socket.socketpair()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, on which sending does not wait
        child = os.fork()
    if child == 0:
        ours.close()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        if not theirs.recv(1):
            _disarm(link)
        os._exit(0)
    theirs.close()
    try:
        yield
    finally:
        with ours:
            ours.send(b"e")
            os.waitpid(child, 0)


def _fly(
    policy: Supervised,
    source: socket.socket,
    link: Link,
    curve: ThrustCurve,
    log: Any,
    place: "_Place",
    operator: Operator,
) -> Summary:
    period, receiver, fields = float(policy.designed["PERIOD"]), Receiver(), policy.fields
    waiting, asked, restarts, began, flown = None, 0.0, 0, 0.0, (0.0, 0.0)
    late: list[float] = []
    delays: list[float] = []
    usual, shown_at, shown, goal, ending = np.inf, 0.0, "", np.zeros(3), np.inf
    log.writerow(COLUMNS)
    begin, said = time.monotonic(), False
    deadline = begin + _LEAD
    while not operator.has_ended and deadline < ending:
        sample, arrived = _until(deadline, source, receiver, fields.stage in (OFF, HOLD))
        now = time.monotonic()
        if sample is not None:
            wrong = _FOLLOW * (deadline - arrived - _LEAD)
            deadline -= float(np.clip(wrong, -_FASTEST * period, _FASTEST * period))
        if receiver.restarts > restarts:
            usual, waiting, restarts = np.inf, None, receiver.restarts
            operator.note = "there is a new sender of samples"
        waiting = waiting if sample is None else (sample, arrived)
        sample, measurement = None, None
        if waiting is not None and now - deadline < period:  # the last of the steps that are made up for
            (sample, arrived), waiting = waiting, None
            delay = arrived - sample.time
            usual = min(usual + _CLOCKS * period, delay)
            measurement = sample.measurement(delay - usual if delay - usual > period else 0.0)
        for key in pressed():
            operator.press(key)
        if operator.request == FLY and fields.stage != FLY and (link.motors() == 0.0).all():
            operator.kill("the autopilot is not armed")
        before = fields.stage
        status = policy.names(policy.step(measurement, operator.request))
        asked = now if operator.request != FLY or fields.stage == FLY else asked
        if now - asked > _ASKED and operator.request == FLY:
            operator.request, operator.note = HOLD, f"no flight: {' '.join(status)}"
        if operator.is_armed and operator.request != KILL:
            _check(operator, policy, link, now - deadline)
            if cause := place.cause(before, policy, status, None if sample is None else np.array(sample.position)):
                operator.kill(cause)
            if operator.request == KILL:  # not a period later
                status = list(dict.fromkeys([*status, *policy.names(policy.step(None, KILL))]))
        stage, reference = fields.stage, np.array(fields.reference[:3])
        goal = goal if stage == FLY and before == FLY else reference
        if operator.moves.any():
            moved = goal + place.step * operator.moves
            operator.moves[:] = 0.0
            if refused := place.refusal(moved, policy):
                operator.note = f"the set point is refused: {refused}"
            else:
                policy.go_to(goal := moved, fields.reference[21])
        if stage == KILL:
            operator.kill(", ".join(policy.names(fields.cause)))
        try:
            link.send(policy.command, operator.is_armed and stage != KILL)
            for _ in range(_REPEATS if stage == KILL and ending == np.inf else 0):
                time.sleep(_REPEATED)
                link.send(policy.command, False)
        except OSError as error:
            operator.kill(f"the link is lost ({error}): is the autopilot, or the simulation, still running?")
        if operator.request == KILL:
            ending = min(ending, now + _AFTER_KILL)
        if operator.cause and not said:
            show(f"{now - begin:7.1f} s  KILLED: {operator.cause}", True)
            said = True
        began = began if stage == before == FLY else now
        if now - began > flown[1] - flown[0]:
            flown = began - begin, now - begin
        seen = np.full(11, np.nan) if sample is None else np.append(sample.measurement(0.0)[:10], sample.time)
        motors, figures = link.motors(), (seen[10], now - deadline, link.silence())
        numbers = [now], seen[:10], motors, curve.thrust(motors), policy.command, goal, figures
        log.writerow([*np.concatenate(numbers).round(6).tolist(), STAGES[stage], "+".join(status), operator.cause])
        late.append(now - deadline)
        if sample is not None:
            delays.append(time.monotonic() - sample.time)
        title = f"{STAGES[stage]}{'' if operator.is_armed else ', disarmed'} {operator.note}"
        if title != shown or now - shown_at > _SHOWN:
            at = receiver.latest.shown() if receiver.latest else ""
            show(
                f"{now - begin:7.1f} s  {title:14}  age {1e3 * fields.blind:3.0f} ms{at}  {' '.join(status)}",
                title != shown,
            )
            shown, shown_at = title, now
        deadline += period
    return Summary(operator.cause, np.array(late), np.array(delays), receiver, flown)


class _Place:
    """Where a flight began and where it was released, for the fence, for set points, and for HOLD after a flight."""

    def __init__(self, step: float, fence: float) -> None:
        self.step, self._fence = step, fence
        self._began: Floats | None = None
        self._released: Floats | None = None
        self._latest: Floats | None = None

    def cause(self, before: int, policy: Supervised, status: list[str], position: Floats | None) -> str:
        """Return why a step kills, or nothing. HOLD after a flight is in a hand: it must stay there."""
        stage, position = policy.fields.stage, None if "BLIND" in status else position
        self._latest = self._latest if position is None else position
        if stage != before and stage == FLY:
            self._began, self._released = self._latest, None
        elif stage != before:
            self._released = self._latest if before == FLY and stage == HOLD else None
        if self._released is not None and (beyond := sorted(_RELEASED.intersection(status))):
            return f"{', '.join(beyond)} after the release"
        if position is None:
            return ""
        if self._released is not None and np.linalg.norm(position - self._released) > policy.fields.distance:
            return "the vehicle moved after the release"
        if stage == FLY and not self._is_inside(position):
            return "the vehicle is beyond the fence"
        return ""

    def refusal(self, goal: Floats, policy: Supervised) -> str:
        """Return why a set point is refused, or nothing."""
        fields = policy.fields
        if fields.stage != FLY:
            return "nothing flies"
        if not fields.lowest < goal[2] < fields.highest:
            return "its height"
        if np.linalg.norm(goal - fields.reference[:3]) > _AHEAD * self.step:
            return "the one before is not reached"
        return "" if self._is_inside(goal) else "it is beyond the fence"

    def _is_inside(self, position: Floats) -> bool:
        return self._began is None or bool(np.linalg.norm(position[:2] - self._began[:2]) <= self._fence)


def _check(operator: Operator, policy: Supervised, link: Link, late: float) -> None:
    """Kill where the supervisor does not: its limit of age lets drop-outs pass, and it sees neither link nor clock."""
    if policy.fields.status & policy.bits["FROZEN"] and policy.fields.blind > _FROZEN and operator.request == FLY:
        operator.kill("motion capture is frozen")
    if late > _PATIENCE:
        operator.kill(f"a step was late by {1e3 * late:.0f} ms")
    if (silence := link.silence() - max(late, 0.0)) > _PATIENCE:  # a late step reads late
        operator.kill(f"the autopilot has not answered for {1e3 * silence:.0f} ms")
