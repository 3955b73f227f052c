"""Vehicles whose rotors an autopilot drives in place of the rate loop, in steps of at most 1 ms.

In each step the firmware gets the body rates and, as radio channels, the thrust and the body rates that act then (see
`loops`). While it runs for the length of a step, the vehicles advance under its previous outputs, which it has made
from the body rates one step before.
"""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from quadpend_gym.autopilots.betaflight import PID_PERIOD, Betaflight, radio
from quadpend_gym.autopilots.firmware import Firmware
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.envs.inputs import NO_ERROR
from quadpend_gym.envs.kernel_layout import MEMORY_SIZE
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.envs.step_kernel import ADVANCE
from quadpend_gym.physics.plant_kernel import LOOP_SIZE
from quadpend_gym.physics.rigid_kernel import BODY_RATE, RIGID_SIZE
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.vehicles import Simulation, hover_thrusts, rotors_of

_RATES = slice(MEMORY_SIZE + BODY_RATE, MEMORY_SIZE + BODY_RATE + 3)
_ROTORS = slice(MEMORY_SIZE + RIGID_SIZE, MEMORY_SIZE + RIGID_SIZE + ACTION_SIZE)


class AutopilotRows:
    """The loops and the firmware of n sub-environments, in place of a `Schedule`.

    Attributes:
        plant_simulation: Simulation of one step of the firmware, with the interface "rotors".
        steps: Number of these steps in a control period.
        slots: 2: the kernel gets the actions of the rotors as those of the step before.
        loops: As in `Schedule`, of one substep.
        drawn: As in `Schedule`.
    """

    def __init__(self, autopilot: Betaflight, ranges: LoopRanges | None, simulation: Simulation, rows: int) -> None:
        substeps = simulation.substeps * ceil(simulation.period / simulation.substeps / PID_PERIOD * (1.0 - 1e-9))
        self._simulation = simulation = replace(simulation, substeps=substeps)
        self._schedule = schedule = Schedule(ranges, simulation, rows)
        self.loops, self.drawn, self.slots = schedule.loops[: LOOP_SIZE + 1].copy(), schedule.drawn, 2
        self.loops[LOOP_SIZE] = 1.0
        self.steps, step, vehicle = substeps, simulation.period / substeps, simulation.vehicle
        self.plant_simulation = replace(simulation, interface="rotors", period=step, substeps=1, latency=0.0)
        self._scale = simulation.command_scale[:, np.newaxis]
        (self._low, self._high), self._hover = rotors_of(vehicle).thrust, hover_thrusts(vehicle)
        (hover,) = radio(np.zeros(1) + vehicle.weight, np.zeros((1, 3)), simulation)
        self._firmware = Firmware(autopilot.prepare(simulation), rows, step, hover)
        self._motors, self._issued = np.zeros((rows, ACTION_SIZE)), np.zeros((schedule.slots, ACTION_SIZE, rows))

    def start_episodes(self, rows: Integers, streams: Streams) -> None:
        """Draw the constants of new episodes, and start their firmware anew."""
        self._schedule.start_episodes(rows, streams)
        self.loops[:LOOP_SIZE] = self._schedule.loops[:LOOP_SIZE]
        self._issued[:, :, rows] = 0.0
        self._motors[rows] = self._firmware.start_episodes(rows)[:ACTION_SIZE]

    def loops_of(self, rows: Integers) -> Floats:
        """As `Schedule.loops_of`."""
        return self.loops if self._schedule.ranges is None else self.loops[:, rows]

    def advance(self, step: Integers) -> None:
        """As `Schedule.advance`."""
        self._schedule.advance(step)
        self.loops[:LOOP_SIZE] = self._schedule.loops[:LOOP_SIZE]

    def run(
        self, kernel: Any, stages: int, memory: Floats, clock: Integers, columns: Floats, action: Any, *arguments: Any
    ) -> int:
        """As `kernel`, for all sub-environments: `step_kernel.run_rigid` or `run_held`.

        The settings are those of `plant_simulation`.
        """
        self._issued[:-1], self._issued[-1] = self._issued[1:], action.T
        for number, ages in enumerate(self._schedule.ages):
            place = np.broadcast_to(len(self._issued) - 1 - ages.astype(np.int64), len(action))
            acting = np.take_along_axis(self._issued, place[np.newaxis, np.newaxis], axis=0)
            thrust, *rates = self._scale * acting[0]
            channels = radio(thrust + self._scale[0], np.array(rates).T, self._simulation)
            self._firmware.send(memory[:, _RATES], channels)
            memory[:, _ROTORS] = self._rotor_actions()
            stage, time = stages if number == self.steps - 1 else ADVANCE, clock * self.steps + number
            error: int = kernel(stage, memory, time, columns, action, *arguments)
            self._motors[:] = self._firmware.receive()[:, :ACTION_SIZE]
            if error != NO_ERROR:
                return error
        clock += 1
        return NO_ERROR

    def _rotor_actions(self) -> Floats:
        """Return the actions of the interface "rotors" for the outputs of the motors, shape (n, 4)."""
        share = np.clip((self._motors - 1000.0) / 1000.0, 0.0, 1.0)
        above = self._low + share * (self._high - self._low) - self._hover
        return above / np.where(above > 0.0, self._high - self._hover, self._hover - self._low)

    def close(self) -> None:
        """End the processes of the firmware."""
        self._firmware.close()
