"""The data that a picture shows of one sub-environment at one instant."""

from typing import NamedTuple

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.tasks.trajectories import Trajectory
from quadpend_gym.viewer.shape import PAPER_SHAPE, Shape


class Snapshot(NamedTuple):
    """One sub-environment at one instant. All vectors are in the world frame."""

    time: float  # time since the episode began, s
    state: State  # state, see `quadpend_gym.physics.state`
    rod_length: float  # length of the rod, m
    reference: Trajectory  # reference, see `quadpend_gym.tasks.references` and `quadpend_gym.tasks.trajectories`
    disturbance: Floats  # disturbance during the last step, shape (9,), see `quadpend_gym.physics.state.Disturbance`
    thrust: float  # thrust of the last step divided by the weight
    error: float  # norm of the tracking error, m
    tilt: float  # angle of the pendulum from its side, rad
    tilt_limit: float  # tilt at which an episode terminates, rad
    episode_return: float  # sum of the rewards of the episode so far
    focus: Floats  # point that the camera follows, m, shape (3,)
    trail: Floats  # past positions ζ + l r, the latest last, m, shape (k, 3)
    streak_offset: Floats  # displacement of the wind streaks since the episode began, m, shape (3,)
    rotor_angle: float  # angle of the drawn rotor blades, rad
    shape: Shape = PAPER_SHAPE  # sizes of the vehicle
    side: float = 1.0  # side of the pendulum: 1 if it is to be upright, −1 if it is to hang

    @property
    def reference_arm(self) -> float:
        """Height of the bob's reference above that of the quadrotor, m."""
        return self.side * self.rod_length
