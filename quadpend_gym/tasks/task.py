"""Settings of a task: references, random starts, termination limits and reward weights.

`gym.make` accepts a task as a name, a `Task`, or a mapping of its fields. Environment specifications store it as JSON.
"""

from dataclasses import astuple, replace
from typing import Annotated, Any, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.settings import Interval, Parsed, Range, parse, settings, suggest
from quadpend_gym.tasks.trajectories import TrajectoryField

EPISODE_STEPS = 1000  # control steps after which an episode is truncated: 10 s at the default control period


@settings
class ReferenceSettings:
    """Relative frequency of each family of random references, and the bounds of their numbers."""

    hover: Annotated[float, Range(0.0, 1e6)] = 1.0  # relative frequencies of the families; that of slaloms is below
    circle: Annotated[float, Range(0.0, 1e6)] = 1.0
    figure_eight: Annotated[float, Range(0.0, 1e6)] = 1.0
    helix: Annotated[float, Range(0.0, 1e6)] = 1.0
    height: Annotated[Interval, Range(0.0, 10_000.0, "m")] = (2.0, 3.0)  # above the ground z = 0
    radius: Annotated[Interval, Range(1e-3, 1000.0, "m")] = (0.3, 1.5)
    acceleration: Annotated[Interval, Range(0.0, 1000.0, "m/s²")] = (0.2, 1.0)  # peak of the horizontal acceleration
    climb: Annotated[Interval, Range(-1000.0, 1000.0, "m/s")] = (-0.1, 0.1)  # vertical velocity of a helix
    # largest absolute value of the constant part of the yaw
    yaw_offset: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.5
    # largest amplitude of the sinusoidal part of the yaw
    yaw_amplitude: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.3
    yaw_frequency: Annotated[float, Range(0.0, 10_000.0, "rad/s")] = 1.0  # largest angular frequency of the yaw
    # relative frequency of slaloms; it is one of the last fields, so that the draws of older tasks stay the same
    slalom: Annotated[float, Range(0.0, 1e6)] = 0.0
    speed: Annotated[Interval, Range(0.0, 1000.0, "m/s")] = (1.0, 3.0)  # forward velocity of a slalom

    def __post_init__(self) -> None:
        if not (self.hover or self.circle or self.figure_eight or self.helix or self.slalom):
            raise ValueError("one of hover, circle, figure_eight, helix and slalom must be above zero")


@settings
class StartSettings:
    """Largest deviation of a random start, in each component, from the state that tracks the reference exactly."""

    position: Annotated[float, Range(0.0, 1000.0, "m")] = 0.1  # position of the quadrotor
    velocity: Annotated[float, Range(0.0, 1000.0, "m/s")] = 0.05  # velocity of the quadrotor
    angle: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.03  # roll, pitch and yaw
    angle_rate: Annotated[float, Range(0.0, 1000.0, "rad/s")] = 0.05
    direction: Annotated[float, Range(0.0, 0.9)] = 0.03  # r, before its normalisation
    # ṙ, before its projection onto the plane perpendicular to r
    direction_rate: Annotated[float, Range(0.0, 1000.0, "1/s")] = 0.05
    # angle by which r is then turned to a random side, drawn uniformly by the area on the sphere
    pendulum_angle: Annotated[Interval, Range(0.0, np.pi, "rad")] = (0.0, 0.0)


@settings
class Limits:
    """Limits of the state; an episode that exceeds one of them terminates (a fall)."""

    # from `Task.pendulum`; π disables this limit
    pendulum_angle: Annotated[float, Range(0.0, np.pi, "rad")] = np.pi / 3
    body_angle: Annotated[float, Range(0.0, np.pi, "rad")] = np.pi * 80 / 180  # from level; π disables this limit
    tracking_error: Annotated[float, Range(0.0, 1e9, "m")] = 3.0
    # height of the ground, which neither the quadrotor nor the bob may touch
    ground: Annotated[float, Range(-1e9, 1e9, "m")] = 0.0


@settings
class RewardWeights:
    """Weights of the terms of the reward, see `quadpend_gym.tasks.rewards`; they are divided by their sum."""

    tracking: Annotated[float, Range(0.0, 1e6)] = 0.6
    upright: Annotated[float, Range(0.0, 1e6)] = 0.15
    yaw: Annotated[float, Range(0.0, 1e6)] = 0.1
    effort: Annotated[float, Range(0.0, 1e6)] = 0.15
    tip: Annotated[float, Range(0.0, 1.0)] = 0.5  # s, weight of the narrow peak in the tracking term
    pendulum_first: Annotated[float, Range(0.0, 1.0)] = 0.0  # p, how much all terms need the pendulum on its side

    def __post_init__(self) -> None:
        if not (self.tracking or self.upright or self.yaw or self.effort):
            raise ValueError("one of the reward weights must be above zero")


@settings
class Task:
    """Task: references, random starts, termination limits, reward weights, and the side of the pendulum.

    Attributes:
        references: Random references.
        start: Random starts.
        limits: Termination limits.
        reward: Weights of the reward.
        trajectory: Reference of every episode: `Reference`, `Waypoints`, `Sinusoids`, or a mapping as `as_trajectory`
            takes it; None: each episode draws one from `references`.
        pendulum: Side on which the pendulum is to be: ``"upright"``, above the quadrotor, or ``"hanging"``, below it.
            Starts, limit and reward are relative to it.
    """

    references: ReferenceSettings = ReferenceSettings()
    start: StartSettings = StartSettings()
    limits: Limits = Limits()
    reward: RewardWeights = RewardWeights()
    trajectory: Annotated[Any, TrajectoryField] = None
    pendulum: Literal["upright", "hanging"] = "upright"

    @property
    def side(self) -> float:
        """Sign of r_z on the side of the pendulum: 1 for upright, −1 for hanging."""
        return 1.0 if self.pendulum == "upright" else -1.0


_HOVER = ReferenceSettings(
    circle=0.0, figure_eight=0.0, helix=0.0, height=(2.0, 2.0), yaw_offset=0.0, yaw_amplitude=0.0
)
TASKS = {
    "track": Task(),
    "hover": Task(references=_HOVER),
    "swing_up": Task(
        references=replace(_HOVER, height=(3.0, 3.0)),
        start=StartSettings(pendulum_angle=(np.pi, np.pi)),
        limits=Limits(pendulum_angle=np.pi),
        reward=RewardWeights(pendulum_first=1.0),
    ),
    "load": Task(pendulum="hanging"),
    "recovery": Task(
        references=replace(_HOVER, height=(5.0, 5.0)),
        start=StartSettings(velocity=2.0, angle=np.pi, angle_rate=3.0, direction_rate=3.0, pendulum_angle=(0.0, np.pi)),
        limits=Limits(pendulum_angle=np.pi, body_angle=np.pi, tracking_error=4.5),
        reward=RewardWeights(pendulum_first=1.0),
    ),
}

ENVIRONMENTS = {  # tasks by the ids of their environments
    "QuadPendulum-v0": "track",
    "QuadPendulumHover-v0": "hover",
    "QuadPendulumSwingUp-v0": "swing_up",
    "QuadPendulumLoad-v0": "load",
    "QuadPendulumRecovery-v0": "recovery",
}


def as_task(value: Any) -> Task:
    """Convert `value` to a task.

    Args:
        value: Name of a task, `Task`, or mapping of its fields.
    """
    if isinstance(value, str):
        if value not in TASKS:
            raise ValueError(f"there is no task {value!r}{suggest(value, TASKS)}; the tasks are {', '.join(TASKS)}")
        return TASKS[value]
    return parse(Task, value, "task")


TaskField = Parsed(as_task, lambda: Literal[tuple(TASKS)] | Task)  # annotation of a field that holds a task


def flatten(settings: Any) -> Floats:
    """Return the numbers of a settings dataclass in the order of its fields; tuples and nested fields are flattened."""

    def numbers(item: Any) -> list[float]:
        return [x for part in item for x in numbers(part)] if isinstance(item, tuple) else [float(item)]

    return np.array(numbers(astuple(settings)), np.float64)
