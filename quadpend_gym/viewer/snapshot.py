"""The data that a picture shows of one sub-environment at one instant."""

from typing import NamedTuple

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.tasks.trajectories import Trajectory
from quadpend_gym.viewer.shape import PAPER_SHAPE, Shape


class Snapshot(NamedTuple):
    """One sub-environment at one instant. All vectors are in the world frame.

    Attributes:
        time: Time since the episode began, s.
        state: State, see `quadpend_gym.physics.state`.
        rod_length: Length of the rod, m.
        reference: Reference, see `quadpend_gym.tasks.references` and `quadpend_gym.tasks.trajectories`.
        disturbance: Disturbance during the last step, shape (9,), see `quadpend_gym.physics.state.Disturbance`.
        thrust: Thrust of the last step divided by the weight.
        error: Norm of the tracking error, m.
        tilt: Angle of the pendulum from its side, rad.
        tilt_limit: Tilt at which an episode terminates, rad.
        episode_return: Sum of the rewards of the episode so far.
        focus: Point that the camera follows, m, shape (3,).
        trail: Past positions ζ + l r, the latest last, m, shape (k, 3).
        streak_offset: Displacement of the wind streaks since the episode began, m, shape (3,).
        rotor_angle: Angle of the drawn rotor blades, rad.
        shape: Sizes of the vehicle.
        side: Side of the pendulum: 1 if it is to be upright, −1 if it is to hang.
    """

    time: float
    state: State
    rod_length: float
    reference: Trajectory
    disturbance: Floats
    thrust: float
    error: float
    tilt: float
    tilt_limit: float
    episode_return: float
    focus: Floats
    trail: Floats
    streak_offset: Floats
    rotor_angle: float
    shape: Shape = PAPER_SHAPE
    side: float = 1.0

    @property
    def reference_arm(self) -> float:
        """Height of the bob's reference above that of the quadrotor, m."""
        return self.side * self.rod_length
