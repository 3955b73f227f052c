"""Layouts of the arrays that Python passes to the step kernel: settings, memory and sensed values.

Python passes the settings to the kernel as one flat float64 array, because numba unboxes one array faster than a nested
tuple at every call. `pack_settings` writes that array and `unpack_settings` reads it inside the kernel; no other code
depends on the positions.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.rigid_kernel import RIGID_SIZE
from quadpend_gym.physics.rigid_settings import RigidSettings, pack_rigid, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.tasks import Task
from quadpend_gym.tasks.observation import TARGET_SIZE
from quadpend_gym.tasks.references import REFERENCE_SIZE
from quadpend_gym.vehicles import Simulation
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

# Memory of each sub-environment, an array row of MEMORY_SIZE numbers.
MEMORY_STATE = slice(0, STATE_SIZE)
MEMORY_PARAMETERS = slice(MEMORY_STATE.stop, MEMORY_STATE.stop + PARAMETERS_SIZE)
MEMORY_REFERENCE = slice(MEMORY_PARAMETERS.stop, MEMORY_PARAMETERS.stop + REFERENCE_SIZE)
MEMORY_SIZE = MEMORY_REFERENCE.stop
# The row of a rigid vehicle is longer: quaternion, body rate and rotor thrusts (`rigid_kernel`), and the last action.
MEMORY_RIGID = slice(MEMORY_SIZE, MEMORY_SIZE + RIGID_SIZE)
MEMORY_ACTION = slice(MEMORY_RIGID.stop, MEMORY_RIGID.stop + ACTION_SIZE)
RIGID_MEMORY_SIZE = MEMORY_ACTION.stop

# Sensed values of each sub-environment, an array column of SENSED_SIZE numbers: the target and the rod length (m),
# from which the tracking error is computed, and the state as the sensors report it.
SENSED_ROD_LENGTH = TARGET_SIZE
SENSED_STATE = slice(SENSED_ROD_LENGTH + 1, SENSED_ROD_LENGTH + 1 + STATE_SIZE)
SENSED_SIZE = SENSED_STATE.stop


_SETTINGS_SIZE = 18


class CommandScale(NamedTuple):
    """Scale of each component of an action, see `Simulation.command_scale`."""

    thrust: float  # N
    roll: float  # N·m
    pitch: float  # N·m
    yaw: float  # N·m


class KernelLimits(NamedTuple):
    """The limits of a task, `quadpend_gym.tasks.Limits`, with the angles as cosines, and the side of its pendulum."""

    cos_pendulum_angle: float
    cos_body_angle: float
    tracking_error: float  # m
    ground: float  # m
    side: float  # see `Task.side`


class KernelWeights(NamedTuple):
    """The weights of the reward terms, which sum to 1, and the numbers s and p of `quadpend_gym.tasks.rewards`."""

    tracking: float
    upright: float
    yaw: float
    effort: float
    tip: float
    pendulum_first: float


class RigidStep(NamedTuple):
    """What a control step of rigid vehicles needs besides the other settings.

    Attributes:
        vehicle: The vehicle with its interface.
        switch: Number of substeps at the beginning in which the last action acts.
    """

    vehicle: RigidSettings
    switch: int


class KernelSettings(NamedTuple):
    """Settings of a task and a simulation that the step kernel reads.

    Attributes:
        period: Control period, s.
        command_scale: Scale of the action.
        limits: Limits at which an episode terminates.
        weights: Weights of the reward.
        moves_air: Whether a wind model gives an air velocity, so that there is drag.
        substeps: Runge–Kutta steps in a control period; 0 leaves state and clock unchanged.
    """

    period: float
    command_scale: CommandScale
    limits: KernelLimits
    weights: KernelWeights
    moves_air: bool
    substeps: int


def make_settings(task: Task, simulation: Simulation, moves_air: bool, substeps: int) -> KernelSettings:
    """Return the kernel settings of a task and a simulation."""
    limits, reward = task.limits, task.reward
    cos_pendulum_angle, cos_body_angle = np.cos([limits.pendulum_angle, limits.body_angle]).tolist()
    weights = np.array([reward.tracking, reward.upright, reward.yaw, reward.effort])
    weights = weights / weights.sum()
    while np.add.accumulate(weights)[-1] > 1.0:  # by rounding, in the order in which the kernel adds the terms
        weights[weights.argmax()] = np.nextafter(weights.max(), 0.0)
    tracking, upright, yaw, effort = weights.tolist()
    return KernelSettings(
        simulation.period,
        CommandScale(*simulation.command_scale.tolist()),
        KernelLimits(cos_pendulum_angle, cos_body_angle, limits.tracking_error, limits.ground, task.side),
        KernelWeights(tracking, upright, yaw, effort, reward.tip, reward.pendulum_first),
        moves_air,
        substeps,
    )


def pack_settings(settings: KernelSettings) -> Floats:
    """Return the settings as a flat array, shape (18,), which `unpack_settings` reads."""
    period, command_scale, limits, weights, moves_air, substeps = settings
    return np.array([period, *command_scale, *limits, *weights, moves_air, substeps], np.float64)


def pack_rigid_settings(settings: KernelSettings, simulation: Simulation) -> Floats:
    """Return the settings of rigid vehicles as a flat array that `unpack_settings` and `unpack_rigid_step` read."""
    switch = simulation.delayed_substeps % simulation.substeps
    return np.concatenate([pack_settings(settings), [switch], pack_rigid(simulation)])


@inlined
def unpack_rigid_step(packed: Any) -> RigidStep:
    """Return the vehicle in an array that `pack_rigid_settings` made."""
    return RigidStep(unpack_rigid(packed[_SETTINGS_SIZE + 1 :]), int(packed[_SETTINGS_SIZE]))


@inlined
def unpack_settings(packed: Any) -> KernelSettings:
    """Return the settings in an array that `pack_settings` made."""
    return KernelSettings(
        packed[0],
        CommandScale(packed[1], packed[2], packed[3], packed[4]),
        KernelLimits(packed[5], packed[6], packed[7], packed[8], packed[9]),
        KernelWeights(packed[10], packed[11], packed[12], packed[13], packed[14], packed[15]),
        packed[16] > 0.0,
        int(packed[17]),
    )
