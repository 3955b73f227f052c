"""The plants of n sub-environments: what differs between the paper's vehicle and rigid ones in a `World`."""

import numpy as np
from typing_extensions import override

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.delays import delay
from quadpend_gym.envs import kernel_layout as layout
from quadpend_gym.envs.step_kernel import step_euler, step_rigid
from quadpend_gym.physics.plants import RigidPlant, plant_of
from quadpend_gym.physics.rigid_kernel import rigid_from_state
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.task import Task
from quadpend_gym.vehicles import Simulation


class EulerRows:
    """The paper's vehicle, which has no further state, and the latency of every vehicle.

    With a latency of k control periods and s substeps, the action of k + 1 steps ago acts during the first s substeps
    of a step, and the action of k steps ago afterwards. Actions from before the episode are zero: hover.

    Attributes:
        memory: Memory of the step kernel, shape (n, 52); of rigid vehicles (n, 63).
        step: The step kernel.
    """

    step = staticmethod(step_euler)
    _pack_settings = staticmethod(layout.pack_settings)
    _memory_size = layout.MEMORY_SIZE

    def __init__(self, num_envs: int, simulation: Simulation) -> None:
        self.memory = np.zeros((num_envs, self._memory_size))
        self._simulation = simulation
        self._periods = simulation.delayed_substeps // simulation.substeps
        self._under_way = np.zeros((self._periods * ACTION_SIZE, num_envs)).T

    def settings(self, task: Task, moves_air: bool, substeps: int) -> Floats:
        """Return the settings of the step kernel as a flat array."""
        return self._pack_settings(task, self._simulation, moves_air, substeps)

    def start_episodes(self, rows: Integers) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), whose states are in the memory."""
        self.memory[rows, layout.MEMORY_ACTION] = 0.0
        self._under_way[rows] = 0.0

    def delay(self, action: Floats32, clock: Integers) -> Floats32:
        """Return the actions that begin to act in this control step, and keep those that act later, shape (n, 4)."""
        if not self._periods:
            return action
        late = np.asfortranarray(action, np.float64)
        delay(late, clock, self._under_way, self._periods)
        return late.astype(np.float32, order="C")


class RigidRows(EulerRows):
    """Rigid vehicles with their further state and rotors."""

    step = staticmethod(step_rigid)
    _pack_settings = staticmethod(layout.pack_rigid_settings)
    _memory_size = layout.RIGID_MEMORY_SIZE

    @override
    def start_episodes(self, rows: Integers) -> None:
        super().start_episodes(rows)
        state = self.memory[rows, layout.MEMORY_STATE]
        self.memory[rows, layout.MEMORY_RIGID] = rigid_from_state(state, self._simulation)


def plant_rows(num_envs: int, simulation: Simulation) -> EulerRows:
    """Return the rows of n sub-environments with a vehicle."""
    return (RigidRows if isinstance(plant_of(simulation), RigidPlant) else EulerRows)(num_envs, simulation)
