"""The two plants, as objects: how a vehicle moves under actions, and which actions make demanded thrust and torques.

Both have the same methods. They compute a batch of n vehicles with the equations of `quadpend_gym.physics.dynamics` and
`quadpend_gym.physics.rigid_body`.
"""

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from typing_extensions import override

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled
from quadpend_gym.core.packing import pack
from quadpend_gym.physics.allocation import mean_wrench, rigid_actions
from quadpend_gym.physics.euler_kernel import EULER_KERNEL, EulerSettings, advance, advance_euler
from quadpend_gym.physics.plant_kernel import PlantKernel
from quadpend_gym.physics.rigid_kernel import HELD_KERNEL, RIGID_KERNEL, advance_rigid, rigid_from_state
from quadpend_gym.physics.rigid_settings import RigidSettings, make_rigid_settings, nominal_loop
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE, THRUST
from quadpend_gym.physics.vectors import Four
from quadpend_gym.vehicles import Simulation

_HOVER = np.eye(COMMAND_SIZE)[THRUST]


@compiled
def _actions(command: Floats, scale: Floats, action: Floats32) -> None:
    for row in range(command.shape[0]):
        for i in range(COMMAND_SIZE):
            action[row, i] = min(max((command[row, i] - scale[i] * _HOVER[i]) / scale[i], -1.0), 1.0)


class EulerPlant:
    """The paper's vehicle: thrust and torques act as they are commanded.

    Attributes:
        kernel: The functions of the vehicle that compiled code calls.
    """

    kernel: PlantKernel = EULER_KERNEL
    _advance: Any = staticmethod(advance_euler)

    def __init__(self, simulation: Simulation) -> None:
        self.simulation, self._scale = simulation, simulation.command_scale

    @property
    def memory_size(self) -> int:
        """Numbers k of a vehicle besides its state: for rigid vehicles quaternion, body rate and rotor thrusts."""
        return self.kernel.memory_size

    @property
    def held_kernel(self) -> PlantKernel:
        """The functions of a vehicle whose pole a hand can hold."""
        raise ValueError("wind 'hold' needs a rigid vehicle: the paper's attitude model has no hand at the pole")

    def settings(self, moves_air: bool = False) -> EulerSettings | RigidSettings:
        """Return the numbers of the vehicle for compiled functions; the air may move, or rests.

        The paper's vehicle has drag only in air that may move.
        """
        return EulerSettings(Four(*self._scale.tolist()), moves_air)

    def initial_memory(self, state: Floats) -> Floats:
        """Return the memory of vehicles at hover thrust with states of shape (n, 18), shape (n, k)."""
        return np.empty((len(state), 0))

    def command(self, action: Floats32 | Floats) -> Floats:
        """Return the thrust (N) and torques (N·m) of actions, both of shape (n, 4).

        Rigid vehicles: their mean over a control period that begins at hover.
        """
        return np.asarray(self._scale * _HOVER + self._scale * action)

    def actions_for(self, command: Floats, memory: Floats | None = None) -> Floats32:
        """Return the actions that make demanded thrust (N) and torques (N·m), clipped to [−1, 1], shape (n, 4).

        Args:
            command: Demanded thrust and torques about the axes of the body, shape (n, 4).
            memory: Memory at the time when the action begins to act; None: hover.
        """
        action = np.empty(command.shape, np.float32)
        _actions(command, self._scale, action)
        return action

    def advance(
        self, state: Floats, memory: Floats, action: Floats32 | Floats, disturbance: Floats, parameters: Floats
    ) -> None:
        """Advance states and their memories in place by one control period in air at rest, without latency.

        Args:
            state: States, shape (n, 18).
            memory: Memories, shape (n, k).
            action: Actions, shape (n, 4).
            disturbance: d_Q (N), d_B (N) and d_τ (N·m), shape (n, 9); rigid vehicles add their drag to them.
            parameters: Physical parameters in the order of `Parameters.as_array`, shape (n, 9).
        """
        loops = np.repeat(nominal_loop(self.simulation)[:, np.newaxis], len(state), axis=1)
        arrays = state, memory, np.asarray(action, np.float64), loops, disturbance, parameters
        self._advance(*arrays, self._packed, self.simulation.period, self.simulation.substeps)

    @cached_property
    def _packed(self) -> Floats:
        return pack(self.settings())

    def advance_under(self, command: Floats, state: Floats, disturbance: Floats, parameters: Floats) -> None:
        """Advance states in place under thrust (N) and torques (N·m) that act at once, shape (n, 4)."""
        advance(state, command, disturbance, parameters, self.simulation.period, self.simulation.substeps)


class RigidPlant(EulerPlant):
    """A rigid body with rotors, a loop on board, and one of the command interfaces."""

    kernel, held_kernel = RIGID_KERNEL, HELD_KERNEL
    _advance = staticmethod(advance_rigid)

    @override
    def settings(self, moves_air: bool = False) -> RigidSettings:
        return make_rigid_settings(self.simulation)

    @override
    def initial_memory(self, state: Floats) -> Floats:
        return rigid_from_state(state, self.simulation)

    @override
    def command(self, action: Floats32 | Floats) -> Floats:
        return mean_wrench(action, self._hovering(len(action)), self.simulation)

    @override
    def actions_for(self, command: Floats, memory: Floats | None = None) -> Floats32:
        start = self._hovering(len(command)) if memory is None else memory
        return rigid_actions(command, start, self.simulation)

    @override
    def advance_under(self, command: Floats, state: Floats, disturbance: Floats, parameters: Floats) -> None:
        vehicle = replace(self.simulation.vehicle, rotors=None, torque=self.simulation.torque_limits)
        direct = RigidPlant(replace(self.simulation, vehicle=vehicle, interface="wrench", latency=0.0))
        hover = _HOVER * self.simulation.parameters.hover_thrust
        action = (command - hover) / direct.simulation.command_scale
        direct.advance(state, direct.initial_memory(state), action, disturbance, parameters)

    def _hovering(self, rows: int) -> Floats:
        return self.initial_memory(np.zeros((rows, STATE_SIZE)))


@lru_cache(maxsize=128)
def plant_of(simulation: Simulation) -> EulerPlant:
    """Return the plant of a simulation: that of the paper's attitude model, or of a rigid body."""
    return RigidPlant(simulation) if simulation.vehicle.attitude == "rigid" else EulerPlant(simulation)
