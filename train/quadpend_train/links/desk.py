"""The vehicle with its pole in real time, for a flight on the desk: samples by UDP, channels of MSP over TCP.

There is no ground: a flight begins with body and pole in a hand, and ends there.
"""

import socket
import struct
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.envs.env import QuadPendulumEnv
from quadpend_gym.envs.outcome import CAUSES
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles import Simulation, rotors_of
from quadpend_gym.wind.base import HAND
from quadpend_train.links.motion_capture import Sample, pack
from quadpend_train.links.msp import MIN_CHECK, MOTOR, SET_RAW_RC, Reader, command_of, request
from quadpend_train.links.terminal import END, pressed, show
from quadpend_train.policies.compiled import samples_of

PERIOD = 0.002  # s, of the simulation
_PATIENCE = 0.06  # s without channels, after which the receiver disarms
_SWITCHED_ON = 1700  # µs
_HAND = 20.0, 0.5  # stiffness and damping at the pole's top, N/m and N·s/m
_PUSH, _PUSHED = 0.5, 0.3  # N along x, and for how long, s
_OUTLIER = 1.0  # m

HELP = (
    "b the hand lets go or takes the body   p the pole   w push   samples: d none, z frozen, o one outlier"
    "   l the link is silent   q end"
)


class Hand:
    """A wind model to order: a force on the body, and a hand at the pole's top."""

    memory_size, moves_air, holds = 0, False, True

    def __init__(self) -> None:
        self.force, self.place, self.has_pole = np.zeros(3), np.zeros(2), True

    def initial_memory(self, streams: Streams) -> Floats:
        """Return no memory."""
        return np.empty((streams.keys.size, 0))

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the force, and the pull of `quadpend_gym.wind.hand`."""
        out[:, :3] += self.force
        if self.has_pole:
            out[:, HAND] += [*(_HAND[0] * self.place), *_HAND]


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
                self.is_armed = is_on and (self.is_armed or (not self._was_on and channels[2] <= MIN_CHECK))
                self._at, self._was_on, self.command = now, is_on, command_of(channels, self._simulation)
            payload = motors if message.command == MOTOR else b""
            replies += request(message.command, payload, b">")
        if now - self._at > _PATIENCE:
            self.is_armed = False
        return replies


class Desk:
    """The vehicle, the hand and motion capture.

    Args:
        scenario: Vehicle, wind, sensors and start. The desk has its own period, and no latency but that of `run`.
        seed: Of the episode.

    Attributes:
        motors: Outputs of the motors, 0 to 1, shape (4,).
        switches: What the keys b, p, d, z and l have switched on.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._hand = Hand()
        own: dict[str, Any] = {"wind": [*scenario.wind, self._hand], "wind_rise": 0.0, "observation": "lab"}
        own |= {"period": PERIOD, "substeps": 1, "latency": 0.0, "duration": 1e6, "unscored": 0.0}
        self._env = QuadPendulumEnv(replace(scenario, **own))
        self._observation, _ = self._env.reset(seed=seed)
        self._simulation, self._time = self._env.scenario.simulation, 0.0
        self.switches = dict.fromkeys("bpdzl", False)
        self._pushed_until, self._outliers, self._counter = 0.0, 0, 0
        self._frozen = samples_of(self._observation)
        self.press("b")
        self.press("p")

    def press(self, key: str) -> None:
        """Take a key of `HELP`."""
        world, state = self._env.world, self._env.state
        if key in self.switches:
            self.switches[key] = not self.switches[key]
        if key == "w":
            self._pushed_until = self._time + _PUSHED
        if key == "o":
            self._outliers += 1
        if key == "b":
            for rate in (state.velocity, state.euler_rate, state.direction_rate):
                rate[:] = 0.0
            world.plant_memory[0, BODY_RATE : BODY_RATE + 3] = 0.0
            self._held = world.state.copy(), world.plant_memory.copy()
        if key == "p":
            top = self._simulation.vehicle.pole.full_length
            self._hand.place = state.position[:2] + top * state.direction[:2]
            self._hand.has_pole = self.switches[key]

    def step(self, command: Floats) -> str:
        """Advance by `PERIOD` under thrust (N) and body rates (rad/s), shape (4,); return how it fell, or nothing."""
        self._time += PERIOD
        self._hand.force[0] = _PUSH if self._time < self._pushed_until else 0.0
        scale = self._simulation.command_scale
        action = np.clip(command / scale - [1.0, 0.0, 0.0, 0.0], -1.0, 1.0).astype(np.float32)
        self._observation, _, _, _, info = self._env.step(action)
        if self.switches["b"]:
            world = self._env.world
            world.state[:], world.plant_memory[:, :ROTOR_THRUST] = self._held[0], self._held[1][:, :ROTOR_THRUST]
            return ""
        return CAUSES[int(info["cause"])] if info["cause"] else ""

    @property
    def motors(self) -> Floats:
        """Thrusts of the rotors as shares of their range, shape (4,)."""
        low, high = rotors_of(self._simulation.vehicle).thrust
        thrusts: Floats = self._env.world.plant_memory[0, ROTOR_THRUST : ROTOR_THRUST + 4]
        return np.clip((thrusts - low) / (high - low), 0.0, 1.0)

    def sample(self, now: float) -> Sample | None:
        """Return what motion capture sees at a time of its clock, s; None: it misses it."""
        x = samples_of(self._observation)
        if self.switches["d"] or x[10] > 0.0:
            return None
        if not self.switches["z"]:
            self._frozen = x
        x, self._counter = self._frozen.copy(), self._counter + 1
        if self._outliers:
            x[0], self._outliers = x[0] + _OUTLIER, self._outliers - 1
        position, quaternion, direction = (tuple(part.tolist()) for part in np.split(x[:10], [3, 7]))
        return Sample(self._counter, now, position, quaternion, direction)


def run(desk: Desk, receiver: Receiver, server: socket.socket, to: tuple[str, int], every: int, delay: float) -> str:
    """Run in real time until the operator ends or the vehicle falls; return how it ended.

    Args:
        desk: What flies.
        receiver: What takes the channels.
        server: Where the link connects.
        to: Where the samples go.
        every: Periods of the desk between two samples.
        delay: Of the samples, s.
    """
    out, link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), None
    waiting: deque[tuple[float, bytes]] = deque()
    begin = deadline = time.monotonic()
    step, latest, was_armed = 0, 0.0, False
    server.setblocking(False)
    print(HELP, flush=True)
    while True:
        latest = max(latest, time.monotonic() - deadline)
        link, data = _receive(server, link)
        if not desk.switches["l"]:
            outputs = np.rint(1000.0 + 1000.0 * desk.motors).astype(int)
            replies = receiver.take(data, deadline, struct.pack("<8H", *outputs, *[0] * 4))
            if link is not None and replies:
                with suppress(OSError):
                    link.sendall(replies)
        else:
            receiver.take(b"", deadline, b"")
        if receiver.is_armed != was_armed:
            was_armed = receiver.is_armed
            show(f"{deadline - begin:8.3f} s  {'armed' if was_armed else 'disarmed'}", True)
        fallen = desk.step(receiver.command if receiver.is_armed else np.zeros(4))
        step, deadline = step + 1, deadline + PERIOD
        for key in pressed():
            if key in (END, "q"):
                return f"ended after {deadline - begin:.1f} s, behind real time by at most {1e3 * latest:.1f} ms"
            desk.press(key)
            show(f"{deadline - begin:8.3f} s  {key}", True)
        if fallen:
            return f"fell after {deadline - begin:.3f} s: {fallen}"
        if step % every == 0 and (sample := desk.sample(deadline)):
            waiting.append((deadline + delay, pack(sample)))
        time.sleep(max(deadline - time.monotonic(), 0.0))
        while waiting and waiting[0][0] <= deadline + 1e-6:
            out.sendto(waiting.popleft()[1], to)


def _receive(server: socket.socket, link: socket.socket | None) -> tuple[socket.socket | None, bytes]:
    """Return the link, a new one if there is none, and what it has sent."""
    if link is None:
        with suppress(BlockingIOError):
            link, _ = server.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.setblocking(False)
        return link, b""
    try:
        data = link.recv(4096)
    except BlockingIOError:
        return link, b""
    except OSError:
        data = b""
    return (link, data) if data else (None, b"")
