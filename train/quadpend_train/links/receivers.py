"""What takes the channels on the desk: a receiver without firmware, or Betaflight's own process in real time."""

import shutil
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType

import numpy as np

from quadpend_gym.autopilots.betaflight import Betaflight, cli_lines
from quadpend_gym.autopilots.firmware import prepare
from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import Simulation, hover_thrusts, rotors_of
from quadpend_train.links.autopilots import listen
from quadpend_train.links.desk import PERIOD, Desk
from quadpend_train.links.msp import MIN_CHECK, MOTOR, SET_RAW_RC, Reader, command_of, request

_PATIENCE = 0.06  # s without channels, after which the receiver disarms
_SWITCHED_ON = 1700  # µs
_STATE_PORT, _MOTORS_PORT, MSP_PORT = 9003, 9001, 5761  # of Betaflight's target SITL
_START, _STARTS = 4.0, 5  # s, until its gyro is calibrated, and how often it may begin
_BLACKBOX = ("set blackbox_device = VIRTUAL", "set blackbox_sample_rate = 1/1")  # a file in the folder of the process
# Channels act within 1 ms, not 10 ms; without them the motors stop as soon as the firmware can
_LINES = ("set serial_update_rate_hz = 1000", "set failsafe_delay = 1", "set failsafe_procedure = DROP")


class Receiver:
    """Takes the channels as an autopilot does, and answers: arms at the lowest throttle, disarms without channels."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, self._reader = simulation, Reader(b"<")
        self._at, self._was_on = -np.inf, True
        self.is_armed, self.command = False, np.zeros(4)

    def take(self, data: bytes, now: float, motors: bytes) -> bytes:
        """Take what has arrived; return the replies. `motors` is the payload of MSP_MOTOR."""
        replies = b""
        for message in self._reader.read(data):
            if message.command == SET_RAW_RC and len(message.payload) >= 10:
                channels = struct.unpack(f"<{len(message.payload) // 2}H", message.payload)
                is_on = channels[4] > _SWITCHED_ON
                self.is_armed = is_on and (self.is_armed or (not self._was_on and channels[2] < MIN_CHECK))
                self._at, self._was_on, self.command = now, is_on, command_of(channels, self._simulation)
            payload = motors if message.command == MOTOR else b""
            replies += request(message.command, payload, b">")
        if now - self._at > _PATIENCE:
            self.is_armed = False
        return replies


class Direct:
    """A receiver at a TCP port, whose commands act on the vehicle's own rate loop."""

    def __init__(self, server: socket.socket, simulation: Simulation) -> None:
        self._server, self._receiver, self._simulation = server, Receiver(simulation), simulation
        self._links: list[socket.socket] = []  # the one that is connected

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn."""
        return self._receiver.is_armed

    def action(self, now: float, desk: Desk) -> Floats:
        """Take and answer what has arrived; return the action."""
        is_silent = desk.switches["l"]
        outputs = np.rint(1000.0 + 1000.0 * desk.motors).astype(int)
        replies = self._receiver.take(
            b"" if is_silent else self._received(), now, struct.pack("<8H", *outputs, *[0] * 4)
        )
        with suppress(OSError):
            for link in self._links if replies else []:
                link.sendall(replies)
        command = self._receiver.command if self.is_armed else np.zeros(4)
        return command / self._simulation.command_scale - [1.0, 0.0, 0.0, 0.0]

    def _received(self) -> bytes:
        with suppress(BlockingIOError):
            if not self._links:
                link, _ = self._server.accept()
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                link.setblocking(False)
                self._links = [link]
            with suppress(ConnectionError):
                if data := self._links[0].recv(4096):
                    return data
            self._links.pop().close()
        return b""


class Firmware:
    """Betaflight's process with the clock of this computer; it takes MSP at the TCP port 5761 of its own.

    Args:
        simulation: The vehicle.
        blackbox: File for the firmware's log, such as flight.bbl; none: without a log.
    """

    def __init__(self, simulation: Simulation, blackbox: Sequence[Path] = ()) -> None:
        autopilot, vehicle = Betaflight(), simulation.vehicle
        autopilot.check(simulation, None)
        lines = *cli_lines(autopilot, simulation), *_LINES, *_BLACKBOX * len(blackbox)
        self._binary, configured = prepare(autopilot.binary, lines)
        self._blackbox = blackbox
        self._configuration = (configured / "eeprom.bin").read_bytes()
        (self._low, self._high), self._hover = rotors_of(vehicle).thrust, hover_thrusts(vehicle)
        self._outputs, self._open = np.full(4, 1000.0), ExitStack()

    def __enter__(self) -> "Firmware":
        """Start the process. Its threads have a race, in which some starts end: try again."""
        self._socket = self._open.enter_context(listen(f"127.0.0.1:{_MOTORS_PORT}", socket.SOCK_DGRAM))
        for _ in range(_STARTS):
            process = self._open.enter_context(self._process())
            if self._answers():
                return self
            process.kill()
        self._open.close()
        raise OSError(f"Betaflight does not answer at its port {MSP_PORT}: is there another one?")

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End the process."""
        self._open.close()

    @contextmanager
    def _process(self) -> Iterator[subprocess.Popen[bytes]]:
        quiet = subprocess.DEVNULL
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "eeprom.bin").write_bytes(self._configuration)
            process = subprocess.Popen([self._binary], cwd=folder, stdin=quiet, stdout=quiet, stderr=quiet)
            try:
                yield process
            finally:
                process.kill()
                process.wait()
                for file, path in zip(sorted(Path(folder).glob("LOG*")), self._blackbox, strict=False):
                    shutil.copy(file, path)

    def _answers(self) -> bool:
        """Keep the vehicle still until the gyro is calibrated; return whether the firmware answers then."""
        until, reader = time.monotonic() + _START, Reader()
        while time.monotonic() < until:
            self._exchange(np.zeros(3))
            time.sleep(PERIOD)
        with suppress(OSError), socket.create_connection(("127.0.0.1", MSP_PORT), 1.0) as link:
            link.sendall(request(MOTOR))
            return bool(reader.read(link.recv(4096)))
        return False

    @property
    def is_armed(self) -> bool:
        """Whether the motors turn."""
        return bool((self._outputs > 1000.0).any())

    def action(self, now: float, desk: Desk) -> Floats:
        """Send the gyro's rates; return the action of the interface "rotors" of the latest outputs."""
        self._exchange(desk.rates)
        above = self._low + (self._outputs - 1000.0) / 1000.0 * (self._high - self._low) - self._hover
        return above / np.where(above > 0.0, self._high - self._hover, self._hover - self._low)

    def _exchange(self, rates: Floats) -> None:
        with suppress(BlockingIOError):
            while True:
                self._outputs = np.frombuffer(self._socket.recv(68), np.float32)[1:5].astype(float)
        rest = *(0.0, 0.0, -9.80665), *(1.0, 0.0, 0.0, 0.0), *(0.0,) * 6, 101325.0
        with suppress(ConnectionError):  # it does not listen yet
            state = struct.pack("<18d", 0.0, *(rates * (1.0, -1.0, -1.0)), *rest)  # a constant time keeps its clock
            self._socket.sendto(state, ("127.0.0.1", _STATE_PORT))
