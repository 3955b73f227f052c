"""A flight on the desk: `quadpend simulate` and `quadpend fly` as processes, whose keys are pressed at times."""

import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from quadpend_train.links.receivers import MSP_PORT

START = ((0.0, "fly", "a"), (0.5, "fly", "h"), (1.0, "fly", "f"), (1.3, "desk", "b"), (1.8, "desk", "p"))  # then alone
END = ((0.0, "desk", "b"), (0.2, "fly", "h"), (0.4, "fly", "o"), (0.6, "fly", "q"), (0.8, "desk", "q"))  # into the hand


@dataclass
class Flown:
    """What a flight left."""

    log: pd.DataFrame
    fly: str
    desk: str
    pressed: dict[str, float]  # time of each key of `fly`'s clock, s

    @property
    def disarmed(self) -> float:
        """The time of the desk when its receiver disarmed last, s."""
        return float(re.findall(r"([\d.]+) s  disarmed", self.desk)[-1])

    def ordered(self, key: str) -> float:
        """The time of the desk when it took a key last, s."""
        return float(re.findall(rf"([\d.]+) s  {key}  ", self.desk)[-1])


def later(keys: tuple[tuple[float, str, str], ...], seconds: float) -> tuple[tuple[float, str, str], ...]:
    """The keys some seconds later."""
    return tuple((at + seconds, who, key) for at, who, key in keys)


def free_ports() -> tuple[int, int]:
    """A TCP and a UDP port."""
    with socket.socket() as one, socket.socket(type=socket.SOCK_DGRAM) as two:
        for each in (one, two):
            each.bind(("127.0.0.1", 0))
        return one.getsockname()[1], two.getsockname()[1]


def fly_on_the_desk(
    source: Path,
    folder: Path,
    keys: tuple[tuple[float, str, str], ...],
    scenario: str = "flight_breeze",
    seed: int = 0,
    autopilot: str = "direct",
    more: tuple[str, ...] = (),
) -> Flown:
    """Press keys of ``fly`` and ``desk`` at times (s) after the first step; the key ``KILL`` ends the process `fly`.

    `more` are options of `simulate`.
    """
    for name in ("log.csv", "log.toml"):
        (folder / name).unlink(missing_ok=True)
    tcp, udp = free_ports()
    link = tcp if autopilot == "direct" else MSP_PORT
    command = [sys.executable, "-m", "quadpend_train"]
    given = {
        "desk": [
            "simulate",
            "--listen",
            str(tcp),
            "--to",
            str(udp),
            "--scenario",
            scenario,
            "--seed",
            str(seed),
            "--autopilot",
            autopilot,
            *more,
        ],
        "fly": ["fly", source, "--to", f"msp:127.0.0.1:{link}", "--from", str(udp), "--log", folder / "log.csv"],
    }
    processes, output, pressed = {}, {}, {}
    try:
        for who, arguments in given.items():
            with (folder / who).open("w", encoding="utf-8") as written:
                processes[who] = subprocess.Popen(
                    [*command, *arguments], stdin=subprocess.PIPE, stdout=written, stderr=subprocess.STDOUT
                )
            while "q end" not in (folder / who).read_text(encoding="utf-8"):
                assert processes[who].poll() is None, (folder / who).read_text(encoding="utf-8")
                time.sleep(0.05)
        begin = time.monotonic() + 0.3
        for at, who, key in keys:
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            if processes[who].poll() is None:
                pressed[key] = time.monotonic()
                if key == "KILL":
                    processes[who].send_signal(signal.SIGKILL)
                else:
                    stream = processes[who].stdin
                    assert stream is not None
                    stream.write(key.encode())
                    stream.flush()
        until = time.monotonic() + 5.0
        while time.monotonic() < until and any(process.poll() is None for process in processes.values()):
            time.sleep(0.02)
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()
    output = {who: (folder / who).read_text(encoding="utf-8") for who in given}
    return Flown(pd.read_csv(folder / "log.csv"), output["fly"], output["desk"], pressed)
