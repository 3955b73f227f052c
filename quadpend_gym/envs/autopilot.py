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
from quadpend_gym.envs.kernel_layout import MEMORY_RIGID
from quadpend_gym.envs.loops import LoopRows
from quadpend_gym.envs.step_kernel import step_rigid_drawn
from quadpend_gym.physics.rigid_kernel import BODY_RATE
from quadpend_gym.physics.rigid_settings import LOOP_SIZE
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.vehicles import Simulation, hover_thrusts, rotors_of

_RATES = slice(MEMORY_RIGID.start + BODY_RATE, MEMORY_RIGID.start + BODY_RATE + 3)


class AutopilotRows(LoopRows):
    """The loops and the firmware of n sub-environments.

    Attributes:
        plant_simulation: Simulation of one step of the firmware, with the interface "rotors".
        steps: Number of these steps in a control period.
    """

    def __init__(self, autopilot: Betaflight, ranges: LoopRanges | None, simulation: Simulation, rows: int) -> None:
        substeps = simulation.substeps * ceil(simulation.period / simulation.substeps / PID_PERIOD * (1.0 - 1e-9))
        simulation = replace(simulation, substeps=substeps)
        super().__init__(ranges, simulation, rows)
        self.steps, step, vehicle = substeps, simulation.period / substeps, simulation.vehicle
        self.plant_simulation = replace(simulation, interface="rotors", period=step, substeps=1, latency=0.0)
        self._scale = simulation.command_scale[:, np.newaxis]
        (self._low, self._high), self._hover = rotors_of(vehicle).thrust, hover_thrusts(vehicle)
        (hover,) = radio(np.zeros(1) + vehicle.weight, np.zeros((1, 3)), simulation)
        self._firmware = Firmware(autopilot.prepare(simulation), rows, step, hover)
        self._motors, self._kernel_loops = np.zeros((rows, ACTION_SIZE)), np.zeros((LOOP_SIZE + ACTION_SIZE, rows))

    def start_episodes(self, rows: Integers, streams: Streams) -> None:
        """Draw the constants of new episodes, and start their firmware anew."""
        super().start_episodes(rows, streams)
        self._motors[rows] = self._firmware.start_episodes(rows)[:ACTION_SIZE]

    def step(self, memory: Floats, clock: Integers, columns: Floats, action: Any, settings: Any, *outputs: Any) -> int:
        """As `step_kernel.step_rigid`, for all sub-environments; `settings` are those of `plant_simulation`."""
        self._kernel_loops[:LOOP_SIZE] = self.columns[:LOOP_SIZE]
        commands = self.columns[LOOP_SIZE:].reshape(self.steps, ACTION_SIZE, -1)
        for number, command in enumerate(commands):
            thrust, *rates = self._scale * command
            channels = radio(thrust + self._scale[0], np.array(rates).T, self._simulation)
            self._firmware.send(memory[:, _RATES], channels)
            self._kernel_loops[LOOP_SIZE:] = self._rotor_actions().T
            time = clock * self.steps + number
            error = step_rigid_drawn(self._kernel_loops, memory, time, columns, action, settings, *outputs)
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
