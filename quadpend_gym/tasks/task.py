"""Tasks: what to track, where to start, when it is over and what is rewarded, all as data.

A task travels as JSON and is given to `gym.make` by name, as a `Task`, or as a mapping of its fields.
"""

from dataclasses import astuple, dataclass, field, fields
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import check_interval, check_number, from_plain

EPISODE_STEPS = 1000  # control steps of an episode that is not terminated early: 10 s at the default period
Interval = tuple[float, float]


@dataclass(frozen=True)
class ReferenceSettings:
    """Random references: how often each family is drawn, and between which bounds."""

    hover: float = 1.0  # relative frequency of the family
    circle: float = 1.0
    figure_eight: float = 1.0
    helix: float = 1.0
    height: Interval = (2.0, 3.0)  # m, above the ground z = 0
    radius: Interval = (0.3, 1.5)  # m
    acceleration: Interval = (0.2, 1.0)  # m/s², horizontal peak
    climb: Interval = (-0.1, 0.1)  # m/s, of a helix
    yaw_offset: float = 0.5  # rad, drawn in ±
    yaw_amplitude: float = 0.3  # rad
    yaw_frequency: float = 1.0  # rad/s

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
    """Random starts: the largest deviation, in each component, from flying the reference perfectly."""

    position: float = 0.1  # m, of the quadrotor
    velocity: float = 0.05  # m/s
    angle: float = 0.03  # rad, roll, pitch, yaw
    angle_rate: float = 0.05  # rad/s
    direction: float = 0.03  # of r, before it is normalised
    direction_rate: float = 0.05  # 1/s, of ṙ, before it is made perpendicular to r

    def __post_init__(self) -> None:
        for item in fields(self):
            check_number(getattr(self, item.name), item.name, 0.0, 0.9 if item.name == "direction" else np.inf)


@dataclass(frozen=True)
class Limits:
    """When an episode terminates."""

    pendulum_angle: float = np.pi / 3  # rad from upright; π: never
    body_angle: float = np.pi * 80 / 180  # rad from level
    tracking_error: float = 3.0  # m
    ground: float = 0.0  # m, height that neither quadrotor nor bob may touch

    def __post_init__(self) -> None:
        check_number(self.pendulum_angle, "pendulum_angle", 0.0, np.pi)
        check_number(self.body_angle, "body_angle", 0.0, np.pi)
        check_number(self.tracking_error, "tracking_error", 0.0)
        check_number(self.ground, "ground")


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward's terms, which are divided by their sum, and the share of the sharp tip in tracking."""

    tracking: float = 0.6
    upright: float = 0.15
    yaw: float = 0.1
    effort: float = 0.15
    tip: float = 0.5  # s, see `quadpend_gym.tasks.rewards`

    def __post_init__(self) -> None:
        check_number(self.tip, "tip", 0.0, 1.0)
        if (
            sum(check_number(getattr(self, name), name, 0.0) for name in ("tracking", "upright", "yaw", "effort"))
            == 0.0
        ):
            raise ValueError("one of the reward weights must be above zero")


@dataclass(frozen=True)
class Task:
    """A task: references, starts, limits and reward weights."""

    references: ReferenceSettings = field(default_factory=ReferenceSettings)
    start: StartSettings = field(default_factory=StartSettings)
    limits: Limits = field(default_factory=Limits)
    reward: RewardWeights = field(default_factory=RewardWeights)

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, from_plain(item.default_factory, getattr(self, item.name), item.name))  # type: ignore[arg-type]


TASKS = {
    "track": Task(),
    "hover": Task(
        references=ReferenceSettings(
            circle=0.0, figure_eight=0.0, helix=0.0, height=(2.0, 2.0), yaw_offset=0.0, yaw_amplitude=0.0
        )
    ),
}


def as_task(value: Any) -> Task:
    """The task that `value` is, names, or describes as a mapping.

    Raises:
        TypeError: it is none of these.
        ValueError: no task has that name, or a setting is unknown or out of range.
    """
    if isinstance(value, str):
        if value not in TASKS:
            raise ValueError(f"there is no task {value!r}; the tasks are {', '.join(TASKS)}")
        return TASKS[value]
    return from_plain(Task, value, "task")


def flatten(settings: Any) -> Floats:
    """The numbers of a settings dataclass in order of its fields, nested ones and pairs opened: the kernel's view."""

    def numbers(item: Any) -> list[float]:
        return [x for part in item for x in numbers(part)] if isinstance(item, tuple) else [float(item)]

    return np.array(numbers(astuple(settings)), np.float64)
