"""Links to an autopilot: MSP over TCP or a serial port, or one of your own.

A link of your own is a function of the simulation that returns an object with the four methods of `Link`, named
``module:function``. docs/examples has those for MAVLink and for a Crazyflie.
"""

import os
import socket
import struct
import time
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.factories import call_factory, find_factory, is_factory
from quadpend_gym.vehicles import Simulation
from quadpend_train.links.msp import MOTOR, Reader, channels_of, request, set_raw_rc
from quadpend_train.links.thrust import ThrustCurve

_BAUD = 115_200  # of the serial ports of Betaflight
_TIMEOUT = 5.0  # s, for a connection


class Link(Protocol):
    """What `quadpend fly` needs of a link. No method may wait."""

    def send(self, command: Floats, is_armed: bool) -> None:
        """Send thrust (N) and body rates (rad/s; x forward, y left, z up), shape (4,). Raise OSError if it is lost."""

    def silence(self) -> float:
        """Return for how long the autopilot has not answered, s; 0 if it never does."""

    def motors(self) -> Floats:
        """Return the latest outputs of the motors, 0 to 1, in the order of the autopilot, shape (4,); NaN: unknown."""

    def close(self) -> None:
        """Close it; commands have ceased."""


class Msp:
    """Betaflight by MSP_SET_RAW_RC, which it answers. Its MSP_MOTOR gives the outputs of the motors.

    Args:
        stream: A file descriptor that does not block, of a socket or a serial port.
        simulation: The vehicle, and the rates of full deflection.
        curve: Thrust of a rotor at the throttles.
    """

    def __init__(self, stream: int, simulation: Simulation, curve: ThrustCurve) -> None:
        self._stream, self._arguments = stream, (simulation, curve)
        self._reader, self._motors, self._answered = Reader(), np.full(4, np.nan), time.monotonic()

    def send(self, command: Floats, is_armed: bool) -> None:
        """Send the channels; bytes for which there is no room are lost, and the silence grows."""
        with suppress(BlockingIOError):
            while replies := os.read(self._stream, 4096):
                for reply in self._reader.read(replies):
                    self._answered = time.monotonic()
                    if reply.command == MOTOR and len(reply.payload) >= 8:
                        self._motors = (np.array(struct.unpack("<4H", reply.payload[:8])) - 1000.0) / 1000.0
            raise ConnectionError("the autopilot has closed the link")
        with suppress(BlockingIOError):
            os.write(self._stream, set_raw_rc(channels_of(command, is_armed, *self._arguments)) + request(MOTOR))

    def silence(self) -> float:
        """Return for how long the autopilot has not answered, s."""
        return time.monotonic() - self._answered

    def motors(self) -> Floats:
        """Return the latest outputs of the motors, 0 to 1."""
        return self._motors

    def close(self) -> None:
        """Close the stream."""
        os.close(self._stream)


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of ``"HOST:PORT"`` or ``"PORT"``, which is one of this computer."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 2**16:
        raise ValueError(f"an address must be HOST:PORT or PORT, with a port from 1 to 65535, not {text!r}")
    return host or "127.0.0.1", int(port)


def listen(text: str, kind: socket.SocketKind) -> socket.socket:
    """Return a socket for datagrams or connections at the address ``"HOST:PORT"``, which does not block."""
    address = parse_address(text)
    server = socket.socket(socket.AF_INET, kind)
    server.setblocking(False)
    try:
        if kind == socket.SOCK_STREAM:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(address)
        if kind == socket.SOCK_STREAM:
            server.listen()
    except OSError as error:
        server.close()
        raise ValueError(f"nothing can be received at {text}: {error}") from error
    return server


def open_link(name: str, simulation: Simulation, curve: ThrustCurve) -> Link:
    """Return the link ``"msp:HOST:PORT"``, ``"msp:/dev/ttyACM0"``, or that of your own code, ``"module:function"``."""
    kind, _, address = name.partition(":")
    if kind == "msp" and address:
        stream = _serial(address) if address.startswith("/") else _tcp(*parse_address(address))
        return Msp(stream, simulation, curve)
    if not is_factory(name):
        raise ValueError(f"a link must be msp:HOST:PORT, msp:/dev/NAME or module:function, not {name!r}")
    made: Any = call_factory(name, find_factory(name), simulation)
    if lacking := [method for method in ("send", "silence", "motors", "close") if not hasattr(made, method)]:
        raise ValueError(f"the link {name!r} must have the method {lacking[0]}, see docs/first-flight.md")
    return made  # type: ignore[no-any-return]


def _tcp(host: str, port: int) -> int:
    try:
        link = socket.create_connection((host, port), _TIMEOUT)
    except OSError as error:
        raise ValueError(f"there is no autopilot at {host}:{port}: {error}") from error
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.setblocking(False)
    return link.detach()


def _serial(path: str) -> int:
    import termios
    import tty

    stream = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(stream)
    except termios.error as error:
        os.close(stream)
        raise ValueError(f"{path} is no serial port: {error.args[1]}") from error
    settings = termios.tcgetattr(stream)
    settings[4] = settings[5] = getattr(termios, f"B{_BAUD}")
    termios.tcsetattr(stream, termios.TCSANOW, settings)
    return stream
