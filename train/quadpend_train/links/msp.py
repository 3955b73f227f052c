"""The MultiWii Serial Protocol (MSP), version 1, of Betaflight: radio channels out, replies in.

A message is ``$M``, a direction (``<`` to the autopilot, ``>`` its reply, ``!`` its refusal), the size of the payload,
the command, the payload, and the exclusive or of all bytes from the size on. MSP_SET_RAW_RC has channels in µs, u16
little-endian, in the order of the firmware's channel map (AETR): roll, pitch, throttle, yaw, AUX1 and so on. The
firmware sets channels that a message lacks to 0, so a message has all that it uses.
"""

import struct
from collections.abc import Sequence
from functools import reduce
from operator import xor
from typing import NamedTuple

import numpy as np

from quadpend_gym.autopilots.betaflight import full_rates, radio
from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import Simulation, rotors_of
from quadpend_train.links.thrust import ThrustCurve

MOTOR, SET_RAW_RC = 104, 200
_CHANNELS, _LEAST, _MOST = 18, 750, 2250  # the firmware's largest number, and its limits of a valid pulse, µs
_LOW, _HIGH = 1000, 2000  # µs, of a switch
MIN_CHECK = 1005  # µs, the channel of the lowest throttle


class Message(NamedTuple):
    """A reply of the autopilot, or what it gets."""

    command: int
    payload: bytes


def request(command: int, payload: bytes = b"", direction: bytes = b"<") -> bytes:
    """Return the bytes of a message to the autopilot, or of its reply with the direction ``>``."""
    body = bytes([len(payload), command]) + payload
    return b"$M" + direction + body + bytes([reduce(xor, body)])


def set_raw_rc(channels: Sequence[int]) -> bytes:
    """Return the message with these channels, µs."""
    if not 4 <= len(channels) <= _CHANNELS or not all(_LEAST <= channel <= _MOST for channel in channels):
        raise ValueError(f"there must be 4 to {_CHANNELS} channels of {_LEAST} to {_MOST} µs, not {list(channels)}")
    return request(SET_RAW_RC, struct.pack(f"<{len(channels)}H", *channels))


def linear(simulation: Simulation) -> ThrustCurve:
    """Return the thrust that is linear in the throttle, as in the simulation."""
    return ThrustCurve((0.0, 1.0), rotors_of(simulation.vehicle).thrust)


def channels_of(command: Floats, is_armed: bool, simulation: Simulation, curve: ThrustCurve) -> list[int]:
    """Return eight channels, µs, with which Betaflight does what a policy commands.

    Args:
        command: Thrust of all rotors (N) and body rates (rad/s; x forward, y left, z up), shape (4,).
        is_armed: The switch AUX1; a kill switches it off.
        simulation: The vehicle, and the rates of full deflection.
        curve: Thrust of a rotor at the throttles, such as `linear`.
    """
    low, high = rotors_of(simulation.vehicle).thrust
    thrust = 4.0 * (low + (high - low) * curve.throttle(0.25 * command[:1]))
    roll, pitch, throttle, yaw = radio(thrust, command[np.newaxis, 1:], simulation)[0].tolist()
    throttle = throttle if command[0] > 0.0 else _LOW  # the firmware arms only below `MIN_CHECK`
    return [roll, pitch, throttle, yaw, _HIGH if is_armed else _LOW, *[_LOW] * 3]


def command_of(channels: Sequence[int], simulation: Simulation) -> Floats:
    """Return thrust (N) and body rates (rad/s) of channels, shape (4,): what `channels_of` has rounded."""
    roll, pitch, throttle, yaw = np.clip(channels[:4], 1000, 2000)
    low, high = rotors_of(simulation.vehicle).thrust
    share = np.clip((throttle - MIN_CHECK) / (_HIGH - MIN_CHECK), 0.0, 1.0)
    rates = np.array([roll - 1500, pitch - 1500, 1500 - yaw]) / 500.0 * np.radians(10.0 * full_rates(simulation))
    return np.append(4.0 * (low + (high - low) * share), rates)


class Reader:
    """Finds the messages of some directions in the bytes that arrive; bytes that belong to none are left out."""

    def __init__(self, directions: bytes = b">!") -> None:
        self._rest, self._directions = b"", directions

    def read(self, data: bytes) -> list[Message]:
        """Return the replies that are complete with these bytes."""
        found: list[Message] = []
        self._rest += data
        while (start := self._rest.find(b"$M")) >= 0:
            self._rest = self._rest[start:]
            direction, end = self._rest[2:3], 6 + self._rest[3] if len(self._rest) > 3 else 6
            if direction in self._directions and len(self._rest) < end:
                return found
            body = self._rest[3:end]
            if direction and direction in self._directions and reduce(xor, body) == 0:
                found.append(Message(body[1], body[2:-1]))
                self._rest = self._rest[end:]
            else:
                self._rest = self._rest[2:]
        self._rest = self._rest[-1:]
        return found
