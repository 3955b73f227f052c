"""Layouts of the arrays that Python passes to the step kernel: memory, sensed values and settings."""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.euler_kernel import EulerSettings
from quadpend_gym.physics.plants import EulerPlant
from quadpend_gym.physics.rigid_settings import RigidSettings
from quadpend_gym.physics.state import STATE_SIZE
from quadpend_gym.tasks.observation import TARGET_SIZE
from quadpend_gym.tasks.references import REFERENCE_SIZE
from quadpend_gym.tasks.task import Task
from quadpend_gym.vehicles import Simulation
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

# Memory of each sub-environment, an array row of MEMORY_SIZE numbers.
MEMORY_STATE = slice(0, STATE_SIZE)
MEMORY_PARAMETERS = slice(MEMORY_STATE.stop, MEMORY_STATE.stop + PARAMETERS_SIZE)
MEMORY_REFERENCE = slice(MEMORY_PARAMETERS.stop, MEMORY_PARAMETERS.stop + REFERENCE_SIZE)
MEMORY_TRAJECTORY = MEMORY_REFERENCE.stop  # `TrajectoryTable.first`
MEMORY_DIVERGED = MEMORY_TRAJECTORY + 1  # above zero if the state has diverged since the last measurement
MEMORY_POLE = slice(MEMORY_DIVERGED + 1, MEMORY_DIVERGED + 3)  # length (m) and mass (kg) that a policy believes
MEMORY_SIZE = MEMORY_POLE.stop
# The row goes on with what a vehicle has besides the state (`PlantKernel.memory_size`), and ends with the actions that
# can still act, the oldest first, four numbers each (`loops.Schedule`).

# Sensed values of each sub-environment, an array column of SENSED_SIZE numbers: the target and the rod length (m),
# from which the tracking error is computed, the state as the sensors report it, and the age of this sample (s).
SENSED_ROD_LENGTH = TARGET_SIZE
SENSED_STATE = slice(SENSED_ROD_LENGTH + 1, SENSED_ROD_LENGTH + 1 + STATE_SIZE)
SENSED_AGE = SENSED_STATE.stop
SENSED_SIZE = SENSED_AGE + 1


class KernelLimits(NamedTuple):
    """The limits of a task, `quadpend_gym.tasks.Limits`, with the angles as cosines, and the side of its pendulum."""

    cos_pendulum_angle: float
    cos_body_angle: float
    tracking_error: float  # m
    ground: float  # m
    reach: float  # distance of the pole's tip from the pivot, divided by that of its centre of mass
    side: float  # see `Task.side`


class KernelWeights(NamedTuple):
    """The weights of the reward terms, which sum to 1, and the numbers s and p of `quadpend_gym.tasks.rewards`."""

    tracking: float
    upright: float
    yaw: float
    effort: float
    tip: float
    pendulum_first: float


class KernelSettings(NamedTuple):
    """Settings of a task and a simulation that the step kernel reads."""

    period: float  # s
    limits: KernelLimits
    weights: KernelWeights
    has_sensors: bool  # whether the observation is computed from what sensors report
    substeps: int  # Runge–Kutta steps in a control period


unpack_euler = unpacker(tuple[KernelSettings, EulerSettings])
unpack_rigid = unpacker(tuple[KernelSettings, RigidSettings])


def make_weights(task: Task) -> KernelWeights:
    """Return the normalised weights of the reward terms."""
    reward = task.reward
    weights = np.array([reward.tracking, reward.upright, reward.yaw, reward.effort])
    weights = weights / weights.sum()
    while np.add.accumulate(weights)[-1] > 1.0:  # by rounding, in the order in which the kernel adds the terms
        weights[weights.argmax()] = np.nextafter(weights.max(), 0.0)
    tracking, upright, yaw, effort = weights.tolist()
    return KernelWeights(tracking, upright, yaw, effort, reward.tip, reward.pendulum_first)


def make_limits(task: Task, simulation: Simulation) -> KernelLimits:
    """Return the limits of a task for a vehicle."""
    limits, pole = task.limits, simulation.vehicle.pole
    upright, level = np.cos([limits.pendulum_angle, limits.body_angle]).tolist()
    reach = pole.full_length / pole.length
    return KernelLimits(upright, level, limits.tracking_error, limits.ground, reach, task.side)


def pack_settings(task: Task, plant: EulerPlant, moves_air: bool, has_sensors: bool) -> Floats:
    """Return the settings as a flat array that `unpack_euler` or `unpack_rigid` reads; the air may move, or rests."""
    simulation = plant.simulation
    settings = KernelSettings(
        simulation.period,
        make_limits(task, simulation),
        make_weights(task),
        has_sensors,
        simulation.substeps,
    )
    return pack((settings, plant.settings(moves_air)))
