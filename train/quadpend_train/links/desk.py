"""The vehicle with its pole in real time, for a flight on the desk: samples by UDP, channels of MSP over TCP.

There is no ground: a flight begins with body and pole in a hand, and ends there.
"""

import socket
import time
from collections import deque
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.envs.env import QuadPendulumEnv
from quadpend_gym.envs.outcome import CAUSES
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles import rotors_of
from quadpend_gym.vehicles.simulation import Interface
from quadpend_gym.wind.base import HAND
from quadpend_train.links.motion_capture import Sample, pack
from quadpend_train.links.terminal import END, pressed, show
from quadpend_train.policies.compiled import samples_of

PERIOD = 0.001  # s, of the simulation
_HAND = 20.0, 0.5  # stiffness and damping at the pole's top, N/m and N·s/m
_PUSH, _PUSHED = 0.5, 0.3  # N along x, and for how long, s
_OUTLIER = 1.0  # m

_SAID = {  # of a key: when it is switched off, and on
    "b": ("the hand lets the body go", "the hand takes body and pole"),
    "p": ("the hand lets the pole go", "the hand takes the pole"),
    "d": ("samples come", "no samples"),
    "z": ("samples are new", "samples are frozen"),
    "l": ("the link answers", "the link is silent"),
    "w": ("a push",),
    "o": ("one sample is 1 m off",),
}
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


class Desk:
    """The vehicle, the hand and motion capture.

    Args:
        scenario: Vehicle, wind, sensors and start. The desk has its own period, and no latency but that of `run`.
        seed: Of the episode.
        interface: What `step` takes.

    Attributes:
        simulation: The vehicle with its interface.
        switches: What the keys b, p, d, z and l have switched on.
    """

    def __init__(self, scenario: Scenario, seed: int, interface: Interface = "body_rates") -> None:
        if not scenario.sensors:
            raise ValueError(f"the scenario {scenario.name} has no sensors: samples without noise count as frozen")
        self._hand = Hand()
        own: dict[str, Any] = {"wind": [*scenario.wind, self._hand], "wind_rise": 0.0, "observation": "lab"}
        own |= {"period": PERIOD, "substeps": 1, "latency": 0.0, "duration": 1e6, "unscored": 0.0}
        own |= {"interface": interface, "actuators": ()}
        self._env = QuadPendulumEnv(replace(scenario, **own))
        self._observation, _ = self._env.reset(seed=seed)
        self.simulation, self._time = self._env.scenario.simulation, 0.0
        self.switches = dict.fromkeys("bpdzl", False)
        self._pushed_until, self._outliers, self._counter = 0.0, 0, 0
        self._frozen = samples_of(self._observation)
        self.press("b")
        self.press("p")

    def press(self, key: str) -> str:
        """Take a key of `HELP`; return what it did."""
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
            self.rates[:] = 0.0
            self._held = world.state.copy(), world.plant_memory.copy()
        if key == "p":
            top = self.simulation.vehicle.pole.full_length
            self._hand.place = state.position[:2] + top * state.direction[:2]
            self._hand.has_pole = self.switches[key]
        return _SAID[key][self.switches.get(key, False)] if key in _SAID else ""

    def step(self, action: Floats) -> str:
        """Advance by `PERIOD` under an action, shape (4,), which is clipped; return how it fell, or nothing."""
        self._time += PERIOD
        self._hand.force[0] = _PUSH if self._time < self._pushed_until else 0.0
        self._observation, _, _, _, info = self._env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        if self.switches["b"]:
            world = self._env.world
            world.state[:], world.plant_memory[:, :ROTOR_THRUST] = self._held[0], self._held[1][:, :ROTOR_THRUST]
            return ""
        return CAUSES[int(info["cause"])] if info["cause"] else ""

    @property
    def rates(self) -> Floats:
        """Body rates, rad/s, shape (3,)."""
        return self._env.world.plant_memory[0, BODY_RATE : BODY_RATE + 3]

    @property
    def motors(self) -> Floats:
        """Thrusts of the rotors as shares of their range, shape (4,)."""
        low, high = rotors_of(self.simulation.vehicle).thrust
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


class Autopilot(Protocol):
    """What turns the channels into actions of the desk."""

    @property
    def is_armed(self) -> bool:
        """Whether the motors may turn."""

    def action(self, now: float, desk: Desk) -> Floats:
        """Return the action from a time on, shape (4,)."""


def run(desk: Desk, autopilot: Autopilot, to: tuple[str, int], every: int, delay: float) -> str:
    """Run in real time until the operator ends or the vehicle falls; return how it ended.

    Args:
        desk: What flies.
        autopilot: What takes the channels.
        to: Where the samples go.
        every: Periods of the desk between two samples.
        delay: Of the samples, s.
    """
    waiting: deque[tuple[float, bytes]] = deque()
    begin = deadline = time.monotonic()
    step, latest, was_armed = 0, 0.0, False
    print(HELP, flush=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while True:
            latest = max(latest, time.monotonic() - deadline)
            fallen = desk.step(autopilot.action(deadline, desk))
            if autopilot.is_armed != was_armed:
                was_armed = autopilot.is_armed
                show(f"{deadline - begin:8.3f} s  {'armed' if was_armed else 'disarmed'}", True)
            if fallen:
                return f"fell after {deadline - begin:.3f} s: {fallen}"
            step, deadline = step + 1, deadline + PERIOD
            for key in pressed():
                if key in (END, "q"):
                    return f"ended after {deadline - begin:.1f} s, behind real time by at most {1e3 * latest:.1f} ms"
                show(f"{deadline - begin:8.3f} s  {key}  {desk.press(key)}", True)
            if step % every == 0 and (sample := desk.sample(deadline)):
                waiting.append((deadline + delay, pack(sample)))
            time.sleep(max(deadline - time.monotonic(), 0.0))
            while waiting and waiting[0][0] <= deadline + 0.5 * PERIOD:
                out.sendto(waiting.popleft()[1], to)
