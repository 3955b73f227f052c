"""The control step of rigid vehicles: `step_kernel.control_step` with their further state, rotors and latency."""

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.delays import delay
from quadpend_gym.core.jit import compiled
from quadpend_gym.envs.kernel_layout import MEMORY_ACTION, MEMORY_RIGID, MEMORY_STATE, unpack_rigid_step
from quadpend_gym.envs.step_kernel import control_step
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.trajectories import PackedTrajectories
from quadpend_gym.vehicles import Simulation


@compiled
def step_rigid(
    memory: Floats,
    clock: Integers,
    wind: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
) -> int:
    """As `step_kernel.step`, for rigid vehicles.

    `memory` has shape (n, 62), and `settings` are those of `kernel_layout.pack_rigid_settings`.
    """
    rigid = unpack_rigid_step(settings)
    return control_step(memory, clock, wind, action, settings, observation, outcome, outcome[:, :0], None, rigid)


@compiled
def step_rigid_trajectories(
    memory: Floats,
    clock: Integers,
    wind: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    sensed: Floats,
    numbers: Floats,
    first: Integers,
) -> int:
    """As `step_kernel.step_trajectories`, for rigid vehicles."""
    rigid, trajectories = unpack_rigid_step(settings), PackedTrajectories(numbers, first)
    return control_step(memory, clock, wind, action, settings, observation, outcome, sensed, trajectories, rigid)


class RigidRows:
    """The further state of n rigid vehicles, and their actions under way.

    With a latency of k control periods and s substeps, the action of k + 1 steps ago acts during the first s substeps
    of a step, and the action of k steps ago afterwards. Actions from before the episode are zero: hover.

    Args:
        memory: Memory of the step kernel, shape (n, 62), changed in place.
        simulation: The vehicle, its interface and its latency.
    """

    def __init__(self, memory: Floats, simulation: Simulation) -> None:
        """Allocate the arrays; every row needs `start_episodes` before a step."""
        self._memory, self._simulation = memory, simulation
        self._periods = simulation.delayed_substeps // simulation.substeps
        self._under_way = np.zeros((self._periods * ACTION_SIZE, len(memory))).T

    def thrust(self, row: int) -> float:
        """Return the thrust of all rotors of a vehicle, N."""
        rotors = self._memory[row, MEMORY_RIGID][ROTOR_THRUST:]
        return float(rotors.sum() if self._simulation.vehicle.rotors else rotors[0])

    def start_episodes(self, rows: Integers) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), whose states are in the memory."""
        self._memory[rows, MEMORY_RIGID] = rigid_from_state(self._memory[rows, MEMORY_STATE], self._simulation)
        self._memory[rows, MEMORY_ACTION] = 0.0
        self._under_way[rows] = 0.0

    def delay(self, action: Floats32, clock: Integers) -> Floats32:
        """Return the actions that begin to act in this control step, and keep those that act later, shape (n, 4)."""
        if not self._periods:
            return action
        late = np.asfortranarray(action, np.float64)
        delay(late, clock, self._under_way, self._periods)
        return late.astype(np.float32, order="C")
