"""The plants of n sub-environments: what differs between the paper's vehicle and rigid ones in a `World`.

Both classes have the same attributes and methods, and `plant_rows` chooses one of them.
"""

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.delays import delay
from quadpend_gym.envs.kernel_layout import (
    MEMORY_ACTION,
    MEMORY_RIGID,
    MEMORY_SIZE,
    MEMORY_STATE,
    RIGID_MEMORY_SIZE,
    make_settings,
    pack_rigid_settings,
    pack_settings,
)
from quadpend_gym.envs.step_kernel import step_euler, step_rigid
from quadpend_gym.physics.plants import RigidPlant, plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks import Task
from quadpend_gym.vehicles import Simulation


class EulerRows:
    """The paper's vehicle, which has no further state: an action acts at once.

    Args:
        num_envs: Number n of sub-environments.
        simulation: The vehicle.

    Attributes:
        memory: Memory of the step kernel, shape (n, 47).
        step: The step kernel.
    """

    step = staticmethod(step_euler)

    def __init__(self, num_envs: int, simulation: Simulation) -> None:
        self.memory = np.zeros((num_envs, MEMORY_SIZE))
        self._simulation = simulation

    def settings(self, task: Task, moves_air: bool, substeps: int) -> Floats:
        """Return the settings of the step kernel as a flat array."""
        return pack_settings(make_settings(task, self._simulation, moves_air, substeps))

    def start_episodes(self, rows: Integers) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), whose states are in the memory."""

    def delay(self, action: Floats32, clock: Integers) -> Floats32:
        """Return the actions that act in this control step, shape (n, 4)."""
        return action

    def thrust(self, row: int) -> float | None:
        """Return the thrust of all rotors of a vehicle, N; None: it is the commanded one."""
        return None


class RigidRows:
    """Rigid vehicles with their further state, rotors and latency.

    With a latency of k control periods and s substeps, the action of k + 1 steps ago acts during the first s substeps
    of a step, and the action of k steps ago afterwards. Actions from before the episode are zero: hover.

    Args:
        num_envs: Number n of sub-environments.
        simulation: The vehicle, its interface and its latency.

    Attributes:
        memory: Memory of the step kernel, shape (n, 62).
        step: The step kernel.
    """

    step = staticmethod(step_rigid)

    def __init__(self, num_envs: int, simulation: Simulation) -> None:
        self.memory = np.zeros((num_envs, RIGID_MEMORY_SIZE))
        self._simulation = simulation
        self._periods = simulation.delayed_substeps // simulation.substeps
        self._under_way = np.zeros((self._periods * ACTION_SIZE, num_envs)).T

    def settings(self, task: Task, moves_air: bool, substeps: int) -> Floats:
        """Return the settings of the step kernel as a flat array."""
        settings = make_settings(task, self._simulation, moves_air, substeps)
        return pack_rigid_settings(settings, self._simulation)

    def start_episodes(self, rows: Integers) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), whose states are in the memory."""
        self.memory[rows, MEMORY_RIGID] = rigid_from_state(self.memory[rows, MEMORY_STATE], self._simulation)
        self.memory[rows, MEMORY_ACTION] = 0.0
        self._under_way[rows] = 0.0

    def delay(self, action: Floats32, clock: Integers) -> Floats32:
        """Return the actions that begin to act in this control step, and keep those that act later, shape (n, 4)."""
        if not self._periods:
            return action
        late = np.asfortranarray(action, np.float64)
        delay(late, clock, self._under_way, self._periods)
        return late.astype(np.float32, order="C")

    def thrust(self, row: int) -> float | None:
        """Return the thrust of all rotors of a vehicle, N; None: it is the commanded one."""
        rotors = self.memory[row, MEMORY_RIGID][ROTOR_THRUST:]
        return float(rotors.sum() if self._simulation.vehicle.rotors else rotors[0])


def plant_rows(num_envs: int, simulation: Simulation) -> EulerRows | RigidRows:
    """Return the rows of n sub-environments with a vehicle."""
    rigid = isinstance(plant_of(simulation), RigidPlant)
    return RigidRows(num_envs, simulation) if rigid else EulerRows(num_envs, simulation)
