"""The data that a picture shows of one sub-environment at one instant, and the sizes of its vehicle.

The paper's vehicle has no rotors, arms or bob radius; their sizes are chosen. Other vehicles are drawn with the places
of their rotors, their pivot and the length of their pole.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.tasks.trajectories import Trajectory
from quadpend_gym.vehicles import VEHICLES, Vehicle

ARM = 0.2  # m, arm of the paper's vehicle
_PAPER_DISTANCE = 3.4  # m, from the camera to the paper's vehicle


class Shape(NamedTuple):
    """Sizes of a vehicle in pictures, m, in the body frame."""

    hubs: Floats  # ends of the arms, from the centre of mass, shape (4, 3)
    spins: tuple[int, ...] = (1, -1, 1, -1)  # signs of the rotors' yaw torques; a rotor turns against its torque
    front: tuple[bool, ...] = (True, False, False, False)  # whether each rotor is drawn in the colour of the front
    rotor: float = 0.11  # radius of the rotors
    pivot: Floats = np.zeros(3)  # pivot of the pole from the centre of mass, shape (3,)
    bob: float = 0.045  # radius of the ball that marks the pole's centre of mass
    pole: float = 0.016  # width of the pole
    pole_ratio: float = 1.0  # length of the pole divided by the distance from the pivot to its centre of mass
    scale: float = 1.0  # size relative to the paper's vehicle, for body, arms and blades
    distance_scale: float = 1.0  # distance of the camera relative to that from the paper's vehicle
    lift: float = 0.0  # height of the point that the camera looks at above that of the paper's vehicle
    metres_per_newton: float = 0.7  # length of the arrow of a force, m/N


PAPER_SHAPE = Shape(ARM * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))


def shape_of(vehicle: Vehicle) -> Shape:
    """Return the sizes of a vehicle.

    The camera is so far away that the whole pole is in the picture, and the arrow of a force is as long compared with
    the distance as that of the same fraction of the weight with the paper's vehicle.
    """
    if vehicle == VEHICLES["paper"]:
        return PAPER_SHAPE
    spins: tuple[int, ...]
    if vehicle.rotors is not None:
        hubs, spins = np.array(vehicle.rotors.positions), vehicle.rotors.spins
    else:
        arm = 1.6 * np.sqrt(vehicle.inertia_matrix[2, 2] / vehicle.mass)  # as the hummingbird's: 1.6 radii of gyration
        hubs, spins = PAPER_SHAPE.hubs * arm / ARM, PAPER_SHAPE.spins
    reach = float(np.hypot(hubs[:, 0], hubs[:, 1]).max())
    gaps = np.linalg.norm(hubs[:, np.newaxis] - hubs, axis=-1)
    height = vehicle.pole.full_length
    distance = float(np.clip(max(2.2 * height, 8.0 * reach), 0.1 * _PAPER_DISTANCE, 10.0 * _PAPER_DISTANCE))
    scale, distance_scale = reach / ARM, distance / _PAPER_DISTANCE
    return Shape(
        hubs,
        spins,
        tuple((hubs[:, 0] > 0.9 * hubs[:, 0].max()).tolist()),
        0.42 * float(gaps[gaps > 0.0].min()),
        np.array(vehicle.pivot),
        max(0.02 * height, 0.006 * distance),
        max(0.016 * scale, 0.0045 * distance),
        height / vehicle.pole.length,
        scale,
        distance_scale,
        max(height - 0.214 * distance, 0.0),  # the tip is just below the upper edge
        PAPER_SHAPE.metres_per_newton * VEHICLES["paper"].weight / vehicle.weight * distance_scale,
    )


class Snapshot(NamedTuple):
    """One sub-environment at one instant. All vectors are in the world frame."""

    time: float  # time since the episode began, s
    state: State  # state, see `quadpend_gym.physics.state`
    rod_length: float  # length of the rod, m
    reference: Trajectory  # reference, see `quadpend_gym.tasks.references` and `quadpend_gym.tasks.trajectories`
    disturbance: Floats  # disturbance during the last step, shape (9,), see `quadpend_gym.physics.state.Disturbance`
    error: float  # norm of the tracking error, m
    tilt: float  # angle of the pendulum from its side, rad
    episode_return: float  # sum of the rewards of the episode so far
    trail: Floats  # past positions ζ + l r, the latest last, m, shape (k, 3)
    shape: Shape = PAPER_SHAPE  # sizes of the vehicle
    side: float = 1.0  # side of the pendulum: 1 if it is to be upright, −1 if it is to hang

    @property
    def reference_arm(self) -> float:
        """Height of the bob's reference above that of the quadrotor, m."""
        return self.side * self.rod_length
