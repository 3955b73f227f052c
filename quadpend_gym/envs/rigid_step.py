"""The control step of rigid vehicles: `step_kernel.control_step` with their further state, rotors and latency."""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.delays import delay
from quadpend_gym.core.jit import compiled
from quadpend_gym.envs.step_kernel import RigidStep, control_step
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.rigid_kernel import RIGID_SIZE, ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.rigid_settings import pack_rigid
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.trajectories import PackedTrajectories
from quadpend_gym.tasks.trajectory_table import TrajectoryTable


@compiled
def step_rigid(
    memory: Floats,
    clock: Integers,
    wind: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    sensed: Floats,
    rigid: Floats,
    before: Floats32,
    packed: Floats,
    switch: int,
) -> int:
    """As `step_kernel.step`, or as `step_sensed` if `sensed` has n columns, for rigid vehicles.

    `rigid`, `before`, `packed` and `switch` are the fields of `RigidStep`.
    """
    step = RigidStep(rigid, before, packed, switch)
    return control_step(memory, clock, wind, action, settings, observation, outcome, sensed, None, step)


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
    rigid: Floats,
    before: Floats32,
    packed: Floats,
    switch: int,
    numbers: Floats,
    first: Integers,
) -> int:
    """As `step_rigid`, where some sub-environments follow a trajectory.

    `numbers` and `first` are the fields of `PackedTrajectories`.
    """
    step, trajectories = RigidStep(rigid, before, packed, switch), PackedTrajectories(numbers, first)
    return control_step(memory, clock, wind, action, settings, observation, outcome, sensed, trajectories, step)


class RigidRows:
    """The further state of n rigid vehicles, and their actions under way.

    With a latency of k control periods and s substeps, the action of k + 1 steps ago acts during the first s substeps
    of a step, and the action of k steps ago afterwards. Actions from before the episode are zero: hover.

    Args:
        rows: Number n of sub-environments.
        simulation: The vehicle, its interface and its latency.

    Attributes:
        memory: Quaternion, body rate and rotor thrusts, shape (n, 11), see `quadpend_gym.physics.rigid_kernel`.
    """

    def __init__(self, rows: int, simulation: Simulation) -> None:
        """Allocate the arrays; every row needs `start_episodes` before `step`."""
        self._simulation = simulation
        self.memory = np.zeros((rows, RIGID_SIZE))
        self._periods, self._switch = divmod(simulation.delayed_substeps, simulation.substeps)
        self._under_way = np.zeros((self._periods * ACTION_SIZE, rows)).T
        self._before = np.zeros((rows, ACTION_SIZE), np.float32)
        self._packed = pack_rigid(simulation)

    def thrust(self, row: int) -> float:
        """Return the thrust of all rotors of a vehicle, N."""
        rotors = self.memory[row, ROTOR_THRUST:]
        return float(rotors.sum() if self._simulation.rigid_vehicle.rotors else rotors[0])

    def start_episodes(self, rows: Integers, state: Floats) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), with their states, shape (m, 18)."""
        self.memory[rows] = rigid_from_state(state, self._simulation)
        self._under_way[rows] = 0.0
        self._before[rows] = 0.0

    def observe(self, rows: Integers, table: TrajectoryTable, *arguments: Any) -> None:
        """Call the kernel with copies of the rows; `arguments` are those of `step_rigid` up to `sensed`."""
        rigid = self.memory[rows], self._before[rows], self._packed, 0
        if table.in_use:
            step_rigid_trajectories(*arguments, *rigid, table.numbers, table.first[rows])
        else:
            step_rigid(*arguments, *rigid)

    def step(self, table: TrajectoryTable, *arguments: Any) -> int:
        """Call the kernel for all rows; `arguments` are those of `step_rigid` up to `sensed`."""
        memory, clock, wind, action, *rest = arguments
        if self._periods:
            late = np.asfortranarray(action, np.float64)
            delay(late, clock, self._under_way, self._periods)
            action = late.astype(np.float32, order="C")
        rigid = self.memory, self._before, self._packed, self._switch
        if table.in_use:
            error = step_rigid_trajectories(memory, clock, wind, action, *rest, *rigid, table.numbers, table.first)
        else:
            error = step_rigid(memory, clock, wind, action, *rest, *rigid)
        self._before = action
        return error
