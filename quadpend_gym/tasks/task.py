"""Settings of a task: references, random starts, termination limits and reward weights.

`gym.make` accepts a task as a name, a `Task`, or a mapping of its fields. Environment specifications store it as JSON.
"""

from dataclasses import astuple, dataclass, field, fields
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import check_interval, check_number, from_plain, suggest
from quadpend_gym.tasks.trajectories import as_trajectory

EPISODE_STEPS = 1000  # control steps after which an episode is truncated: 10 s at the default control period
Interval = tuple[float, float]


@dataclass(frozen=True)
class ReferenceSettings:
    """Relative frequency of each family of random references, and the bounds of their numbers."""

    hover: float = 1.0  # relative frequencies of the four families
    circle: float = 1.0
    figure_eight: float = 1.0
    helix: float = 1.0
    height: Interval = (2.0, 3.0)  # m, above the ground z = 0
    radius: Interval = (0.3, 1.5)  # m
    acceleration: Interval = (0.2, 1.0)  # m/s², peak of the horizontal acceleration
    climb: Interval = (-0.1, 0.1)  # m/s, vertical velocity of a helix
    yaw_offset: float = 0.5  # rad, largest absolute value of the constant part of the yaw
    yaw_amplitude: float = 0.3  # rad, largest amplitude of the sinusoidal part of the yaw
    yaw_frequency: float = 1.0  # rad/s, largest angular frequency of the yaw

    def __post_init__(self) -> None:
        weights = [
            check_number(getattr(self, name), name, 0.0) for name in ("hover", "circle", "figure_eight", "helix")
        ]
        if sum(weights) == 0.0:
            raise ValueError("one of hover, circle, figure_eight and helix must be above zero")
        for name, low in (("height", 0.0), ("radius", 0.0), ("acceleration", 0.0), ("climb", -np.inf)):
            object.__setattr__(self, name, check_interval(getattr(self, name), name, low))
        if self.radius[0] == 0.0:
            raise ValueError(f"radius must be above zero, not {self.radius!r}")
        for name in ("yaw_offset", "yaw_amplitude", "yaw_frequency"):
            check_number(getattr(self, name), name, 0.0)


@dataclass(frozen=True)
class StartSettings:
    """Largest deviation of a random start, in each component, from the state that tracks the reference exactly."""

    position: float = 0.1  # m, position of the quadrotor
    velocity: float = 0.05  # m/s, velocity of the quadrotor
    angle: float = 0.03  # rad, roll, pitch and yaw
    angle_rate: float = 0.05  # rad/s
    direction: float = 0.03  # r, before its normalisation
    direction_rate: float = 0.05  # 1/s, ṙ, before its projection onto the plane perpendicular to r

    def __post_init__(self) -> None:
        for item in fields(self):
            check_number(getattr(self, item.name), item.name, 0.0, 0.9 if item.name == "direction" else np.inf)


@dataclass(frozen=True)
class Limits:
    """Limits of the state; an episode that exceeds one of them terminates (a fall)."""

    pendulum_angle: float = np.pi / 3  # rad from upright; π disables this limit
    body_angle: float = np.pi * 80 / 180  # rad from level; π disables this limit
    tracking_error: float = 3.0  # m
    ground: float = 0.0  # m, height of the ground, which neither the quadrotor nor the bob may touch

    def __post_init__(self) -> None:
        check_number(self.pendulum_angle, "pendulum_angle", 0.0, np.pi)
        check_number(self.body_angle, "body_angle", 0.0, np.pi)
        check_number(self.tracking_error, "tracking_error", 0.0)
        check_number(self.ground, "ground")


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the terms of the reward, see `quadpend_gym.tasks.rewards`; they are divided by their sum."""

    tracking: float = 0.6
    upright: float = 0.15
    yaw: float = 0.1
    effort: float = 0.15
    tip: float = 0.5  # s, weight of the narrow peak in the tracking term

    def __post_init__(self) -> None:
        check_number(self.tip, "tip", 0.0, 1.0)
        if (
            sum(check_number(getattr(self, name), name, 0.0) for name in ("tracking", "upright", "yaw", "effort"))
            == 0.0
        ):
            raise ValueError("one of the reward weights must be above zero")


@dataclass(frozen=True)
class Task:
    """Task: references, random starts, termination limits and reward weights.

    Attributes:
        references: Random references.
        start: Random starts.
        limits: Termination limits.
        reward: Weights of the reward.
        trajectory: Reference of every episode: `Reference`, `Waypoints`, `Sinusoids`, or a mapping as `as_trajectory`
            takes it; None: each episode draws one from `references`.
    """

    references: ReferenceSettings = field(default_factory=ReferenceSettings)
    start: StartSettings = field(default_factory=StartSettings)
    limits: Limits = field(default_factory=Limits)
    reward: RewardWeights = field(default_factory=RewardWeights)
    trajectory: Any = None

    def __post_init__(self) -> None:
        if self.trajectory is not None:
            object.__setattr__(self, "trajectory", as_trajectory(self.trajectory, "trajectory"))
        for item in fields(self):
            if item.name != "trajectory":
                kind: Any = item.default_factory
                object.__setattr__(self, item.name, from_plain(kind, getattr(self, item.name), item.name))


TASKS = {
    "track": Task(),
    "hover": Task(
        references=ReferenceSettings(
            circle=0.0, figure_eight=0.0, helix=0.0, height=(2.0, 2.0), yaw_offset=0.0, yaw_amplitude=0.0
        )
    ),
}


def as_task(value: Any) -> Task:
    """Convert `value` to a task.

    Args:
        value: Name of a task, `Task`, or mapping of its fields.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If no task has that name, or a setting is unknown or out of range.
    """
    if isinstance(value, str):
        if value not in TASKS:
            raise ValueError(f"there is no task {value!r}{suggest(value, TASKS)}; the tasks are {', '.join(TASKS)}")
        return TASKS[value]
    return from_plain(Task, value, "task")


def flatten(settings: Any) -> Floats:
    """Return the numbers of a settings dataclass in the order of its fields; tuples and nested fields are flattened."""

    def numbers(item: Any) -> list[float]:
        return [x for part in item for x in numbers(part)] if isinstance(item, tuple) else [float(item)]

    return np.array(numbers(astuple(settings)), np.float64)
