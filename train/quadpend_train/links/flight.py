"""A flight: samples of motion capture in, the supervised policy at its rate, commands out, a log.

Every step has an absolute deadline. Their rate is that of the policy, and their phase follows the samples: a step comes
`_LEAD` after the arrival of a sample. A step that is late is made up for at once, since policies predict by their
period. The operator's keys are requests; the stage is that of the supervisor.
"""

import csv
import gc
import select
import socket
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.links.autopilots import Link
from quadpend_train.links.motion_capture import SIZE, Receiver
from quadpend_train.links.supervised import FLY, HOLD, KILL, OFF, STAGES, Supervised
from quadpend_train.links.terminal import END, pressed, show

_LEAD = 0.002  # s, from the arrival of a sample to the step that uses it
_FOLLOW, _FASTEST = 0.05, 0.02  # share of a wrong phase that a step corrects, and the most, as a share of the period
_CLOCKS = 1e-4  # s/s, by which the sender's clock may drift
_PATIENCE, _FROZEN = 0.06, 0.055  # s, that the link may be silent or a step late, and that samples may be frozen
_MOST = 100  # datagrams in a step: a flood must not stop it
_FIRST = 10.0  # s, to wait for the first sample
_SHOWN = 0.2  # s, between two lines of the terminal
_AFTER_KILL = 0.3  # s, for which a kill is repeated
_REPEATS, _REPEATED = 10, 0.002  # at once, at these times (s): Betaflight disarms after four messages in a row

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
COLUMNS = (  # those of `quadpend identify`, and others
    *("time", "x", "y", "z", "qw", "qx", "qy", "qz", "rx", "ry", "rz", "motor1", "motor2", "motor3", "motor4"),
    *("thrust", "rate_x", "rate_y", "rate_z", "goal_x", "goal_y", "goal_z"),
    *("exposure", "late", "silence", "stage", "status", "cause"),
)


@dataclass
class Operator:
    """What the operator asks for. Arming comes first; a key without a meaning kills, and so does a closed terminal."""

    request: int = OFF
    is_armed: bool = False
    cause: str = ""  # of a kill
    has_ended: bool = False
    moves: Floats = field(default_factory=lambda: np.zeros(3))

    def kill(self, cause: str) -> None:
        """Request the kill, for ever; the first cause stays."""
        self.request, self.cause = KILL, self.cause or cause

    def press(self, key: str) -> None:
        """Take a key."""
        request, is_armed = KEYS.get(key, (KILL, False))
        if key == END:
            self.kill("the terminal is closed")
        elif key == "q" and not self.is_armed:
            self.has_ended = True
        elif key in MOVES:
            self.moves += MOVES[key]
        elif request == KILL or self.request == KILL or (request == OFF and self.request == FLY):
            self.kill(f"the key {key!r}")
        elif self.is_armed or request == OFF:
            self.request, self.is_armed = request, is_armed


class Summary(NamedTuple):
    """What a flight was like."""

    cause: str  # of the kill; empty: there was none
    late: Floats  # of each step after its deadline, s
    delays: Floats  # of commands after the exposure of their sample by the sender's clock, s
    lost: int  # samples

    def sentences(self) -> list[str]:
        """Return the figures of the flight."""
        usual, worst = 1e3 * np.quantile(self.late, 0.99), 1e3 * self.late.max()
        found = [
            f"{len(self.late)} steps, late by at most {usual:.2f} ms in 99 % of them and by {worst:.2f} ms in all",
            f"{self.lost} samples were lost",
        ]
        if len(self.delays) and 0.0 < (median := float(np.median(self.delays))) < 1.0:  # the clocks are the same
            most = 1e3 * np.quantile(self.delays, 0.99)
            found.append(f"Commands left {1e3 * median:.1f} ms after the exposure (median; 99 %: {most:.1f} ms)")
        return [*found, f"Killed: {self.cause}" if self.cause else "Not killed"]


def fly(policy: Supervised, source: socket.socket, link: Link, path: Path, step: float) -> Summary:
    """Fly until the operator ends or a kill.

    Args:
        policy: What flies, with its limits.
        source: Of samples, a socket that does not block.
        link: To the autopilot; it is closed at the end.
        path: Of the log, a new CSV file with `COLUMNS`.
        step: Distance by which a key moves the set point, m.
    """
    if not select.select([source], [], [], _FIRST)[0]:
        raise ValueError(f"no sample arrives at port {source.getsockname()[1]} within {_FIRST:g} s")
    operator = Operator()
    gc.collect()
    gc.disable()  # its pauses are longer than a step
    try:
        with path.open("x", newline="", encoding="utf-8", buffering=1) as file:
            return _fly(policy, source, link, csv.writer(file), step, operator)
    finally:
        gc.enable()
        with suppress(OSError):
            for _ in range(3):
                link.send(np.zeros(4), False)
        link.close()


def _fly(policy: Supervised, source: socket.socket, link: Link, log: Any, step: float, operator: Operator) -> Summary:
    period, receiver, fields = float(policy.designed["PERIOD"]), Receiver(), policy.fields
    late: list[float] = []
    delays: list[float] = []
    usual, shown_at, shown, goal, ending = np.inf, 0.0, "", np.zeros(3), np.inf
    log.writerow(COLUMNS)
    begin = time.monotonic()
    deadline = begin + _LEAD
    while not operator.has_ended and deadline < ending:
        datagrams, arrived = _receive_until(source, deadline)
        now = time.monotonic()
        if arrived:
            wrong = _FOLLOW * (deadline - arrived - _LEAD)
            deadline -= float(np.clip(wrong, -_FASTEST * period, _FASTEST * period))
        sample, measurement = receiver.newest(datagrams), None
        if sample is not None:
            delay = arrived - sample.time
            usual = min(usual + _CLOCKS * period, delay)
            measurement = sample.measurement(delay - usual if delay - usual > period else 0.0)
        for key in pressed():
            operator.press(key)
        if operator.request == FLY and fields.stage == HOLD and (link.motors() == 0.0).all():
            operator.kill("the autopilot is not armed")
        status = policy.names(policy.step(measurement, operator.request))
        if operator.is_armed and operator.request != KILL:
            _check(operator, policy, link, now - deadline)
            if operator.request == KILL:  # not a period later
                status = list(dict.fromkeys([*status, *policy.names(policy.step(None, KILL))]))
        stage, reference = fields.stage, np.array(fields.reference[:3])
        goal = (goal if stage == FLY else reference) + step * operator.moves
        if operator.moves.any():
            policy.go_to(goal, fields.reference[21])  # refused where nothing flies
            operator.moves[:] = 0.0
        if stage == KILL:
            operator.kill(", ".join(policy.names(fields.cause)))
        try:
            link.send(policy.command, operator.is_armed and stage != KILL)
            for _ in range(_REPEATS if stage == KILL and ending == np.inf else 0):
                time.sleep(_REPEATED)
                link.send(policy.command, False)
        except OSError as error:
            operator.kill(f"the link is lost: {error}")
        if operator.request == KILL:
            ending = min(ending, now + _AFTER_KILL)
        seen = np.full(11, np.nan) if sample is None else np.append(sample.measurement(0.0)[:10], sample.time)
        numbers = [now], seen[:10], link.motors(), policy.command, goal, seen[10:], (now - deadline, link.silence())
        log.writerow([*np.concatenate(numbers).round(6).tolist(), STAGES[stage], "+".join(status), operator.cause])
        late.append(now - deadline)
        if sample is not None:
            delays.append(time.monotonic() - sample.time)
        title = f"{STAGES[stage]}{'' if operator.is_armed else ', disarmed'} {operator.cause}"
        if title != shown or now - shown_at > _SHOWN:
            place = " ".join(f"{x:6.2f}" for x in receiver.latest.position) if receiver.latest else ""
            line = f"{now - begin:7.1f} s  {title:16}  age {1e3 * fields.blind:3.0f} ms  at {place}  {' '.join(status)}"
            show(line, title != shown)
            shown, shown_at = title, now
        deadline += period
    return Summary(operator.cause, np.array(late), np.array(delays), receiver.lost)


def _receive_until(source: socket.socket, deadline: float) -> tuple[list[bytes], float]:
    """Return the datagrams that arrive until the deadline, and when the last one arrived; 0: none did."""
    datagrams: list[bytes] = []
    arrived = 0.0
    while len(datagrams) < _MOST and select.select([source], [], [], max(deadline - time.monotonic(), 0.0))[0]:
        datagrams.append(source.recv(SIZE + 1))
        arrived = time.monotonic() if len(datagrams[-1]) == SIZE else arrived
    return datagrams, arrived


def _check(operator: Operator, policy: Supervised, link: Link, late: float) -> None:
    """Kill where the supervisor does not: its limit of age lets drop-outs pass, and it sees neither link nor clock."""
    if policy.fields.status & policy.bits["FROZEN"] and policy.fields.blind > _FROZEN and operator.request == FLY:
        operator.kill("motion capture is frozen")
    if (silence := link.silence()) > _PATIENCE:
        operator.kill(f"the autopilot has not answered for {1e3 * silence:.0f} ms")
    if late > _PATIENCE:
        operator.kill(f"a step was late by {1e3 * late:.0f} ms")
