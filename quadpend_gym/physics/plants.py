"""The two plants, as objects: how a vehicle moves under actions, and which actions make demanded thrust and torques.

`plant_of` returns the plant of a simulation: `EulerPlant` for the paper's attitude model, `RigidPlant` for rigid bodies
with rotors and a loop on board. Both have the same methods. They compute a batch of n vehicles with the equations of
`quadpend_gym.physics.dynamics` and `quadpend_gym.physics.rigid_body`.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.allocation import rigid_actions, rotor_response
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.rigid_kernel import (
    BODY_RATE,
    RIGID_SIZE,
    ROTOR_THRUST,
    advance_rigid,
    rigid_from_state,
)
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE, THRUST
from quadpend_gym.vehicles import Simulation


class EulerPlant:
    """The paper's vehicle: thrust and torques act as they are commanded.

    Args:
        simulation: The vehicle with its control period and substeps.

    Attributes:
        memory_size: Numbers of a vehicle besides its state: 0.
        torque_in_world: Whether the torque of a disturbance is a vector of the world frame; else it is about the φ, θ
            and ψ axes.
    """

    memory_size = 0
    torque_in_world = False

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation

    def initial_memory(self, state: Floats) -> Floats:
        """Return the memory of vehicles at hover thrust with states of shape (n, 18), shape (n, 0)."""
        return np.empty((len(state), 0))

    def command(self, action: Floats32 | Floats, memory: Floats | None = None) -> Floats:
        """Return the thrust (N) and torques (N·m) of actions, both of shape (n, 4)."""
        scale = self.simulation.command_scale
        return np.asarray(scale * [1.0, 0.0, 0.0, 0.0] + scale * action)

    def actions_for(self, command: Floats, memory: Floats | None = None) -> tuple[Floats32, Floats]:
        """Return the actions that make demanded thrust (N) and torques (N·m), and what these actions make.

        Args:
            command: Demanded thrust and torques, shape (n, 4).
            memory: Not used.

        Returns:
            Actions clipped to [−1, 1], shape (n, 4), and their thrust and torques, shape (n, 4).
        """
        scale = self.simulation.command_scale
        hover = scale * [1.0, 0.0, 0.0, 0.0]
        action = np.clip((command - hover) / scale, -1.0, 1.0).astype(np.float32)
        return action, self.command(action)

    def advance(
        self,
        state: Floats,
        memory: Floats,
        action: Floats32 | Floats,
        disturbance: Floats,
        parameters: Floats,
        action_before: Floats | None = None,
        switch: int = 0,
    ) -> None:
        """Advance states, shape (n, 18), in place by one control period; see `RigidPlant.advance`."""
        self.advance_under(self.command(action), state, disturbance, parameters)

    def advance_under(self, command: Floats, state: Floats, disturbance: Floats, parameters: Floats) -> None:
        """Advance states in place under thrust (N) and torques (N·m) that act at once, shape (n, 4)."""
        advance(state, command, disturbance, parameters, self.simulation.period, self.simulation.substeps)


class RigidPlant:
    """A rigid body with rotors, a loop on board, and one of the command interfaces.

    Args:
        simulation: The vehicle with its interface, control period and substeps.

    Attributes:
        memory_size: Numbers of a vehicle besides its state: quaternion, body rate and rotor thrusts, see
            `quadpend_gym.physics.rigid_kernel`.
        torque_in_world: As for `EulerPlant`.
    """

    memory_size = RIGID_SIZE
    torque_in_world = True

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation

    def initial_memory(self, state: Floats) -> Floats:
        """Return the memory of vehicles at hover thrust with states of shape (n, 18), shape (n, 11)."""
        return rigid_from_state(state, self.simulation)

    def command(self, action: Floats32 | Floats, memory: Floats | None = None) -> Floats:
        """Return the mean thrust (N) and torques (N·m) of actions over a control period, shape (n, 4).

        Args:
            action: Shape (n, 4).
            memory: Memory at the beginning, shape (n, 11); None: hover.
        """
        start = self._hovering(len(action)) if memory is None else memory
        rate, thrusts = start[:, BODY_RATE : BODY_RATE + 3], start[:, ROTOR_THRUST : ROTOR_THRUST + 4]
        return rotor_response(action, rate, thrusts, self.simulation)[0]

    def actions_for(self, command: Floats, memory: Floats | None = None) -> tuple[Floats32, Floats]:
        """Return the actions that make demanded thrust (N) and torques (N·m), and what these actions make.

        Args:
            command: Demanded thrust and torques about the axes of the body, shape (n, 4).
            memory: Memory at the time when the action begins to act, shape (n, 11); None: hover.

        Returns:
            Actions clipped to [−1, 1], shape (n, 4), and thrust and torques within the limits of the rotors, without
            their lag, shape (n, 4).
        """
        start = self._hovering(len(command)) if memory is None else memory
        unlimited, reached = rigid_actions(command, start, self.simulation)
        return np.clip(unlimited, -1.0, 1.0).astype(np.float32), reached

    def advance(
        self,
        state: Floats,
        memory: Floats,
        action: Floats32 | Floats,
        disturbance: Floats,
        parameters: Floats,
        action_before: Floats | None = None,
        switch: int = 0,
    ) -> None:
        """Advance states, shape (n, 18), and their memories in place by one control period in air at rest.

        Args:
            state: States.
            memory: Memories, shape (n, 11).
            action: Actions, shape (n, 4).
            disturbance: d_Q (N), d_B (N) and d_τ (N·m), shape (n, 9); drag is added to them.
            parameters: Physical parameters, shape (n, 9).
            action_before: Actions during the first `switch` substeps, shape (n, 4); None: `action`.
            switch: Number of substeps at the beginning in which `action_before` acts.
        """
        advance_rigid(
            state,
            memory,
            np.asarray(action, np.float64),
            disturbance,
            parameters,
            self.simulation,
            action_before,
            switch,
        )

    def advance_under(self, command: Floats, state: Floats, disturbance: Floats, parameters: Floats) -> None:
        """Advance states in place under thrust (N) and torques (N·m) that act at once, shape (n, 4)."""
        vehicle = replace(self.simulation.vehicle, rotors=None, torque=self.simulation.torque_limits)
        direct = RigidPlant(replace(self.simulation, vehicle=vehicle, interface="wrench", latency=0.0))
        hover = np.eye(COMMAND_SIZE)[THRUST] * self.simulation.parameters.hover_thrust
        action = (command - hover) / direct.simulation.command_scale
        direct.advance(state, direct.initial_memory(state), action, disturbance, parameters)

    def _hovering(self, rows: int) -> Floats:
        return self.initial_memory(np.zeros((rows, STATE_SIZE)))


Plant = EulerPlant | RigidPlant


@lru_cache(maxsize=128)
def plant_of(simulation: Simulation) -> Plant:
    """Return the plant of a simulation."""
    return RigidPlant(simulation) if simulation.vehicle.attitude == "rigid" else EulerPlant(simulation)
