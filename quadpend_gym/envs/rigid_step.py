"""The compiled control step of rigid vehicles: `step_kernel.control_step` with their state and their rotors."""

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.jit import compiled
from quadpend_gym.envs.step_kernel import RigidStep, control_step
from quadpend_gym.tasks.trajectories import PackedTrajectories


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
