"""Settings of a task: references, random starts, termination limits and reward weights.

`gym.make` accepts a task as a name, a `Task`, or a mapping of its fields. Environment specifications store it as JSON.
"""

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np

from quadpend_gym.core.settings import Parsed, Range, look_up, parse, settings
from quadpend_gym.tasks.jumps import Jumps
from quadpend_gym.tasks.references import ReferenceSettings
from quadpend_gym.tasks.starts import StartSettings
from quadpend_gym.tasks.trajectories import TrajectoryField


@settings
class Limits:
    """Limits of the state; an episode that exceeds one of them terminates (a fall)."""

    # largest angle of the pendulum from the side of `Task.pendulum`; π disables this limit
    pendulum_angle: Annotated[float, Range(0.0, np.pi, "rad")] = np.pi / 3
    # largest angle of the body from level; π disables this limit
    body_angle: Annotated[float, Range(0.0, np.pi, "rad")] = np.pi * 80 / 180
    tracking_error: Annotated[float, Range(0.0, 1e9, "m")] = 3.0  # tracking error beyond which the episode ends
    # height of the ground, which neither the quadrotor nor the tip of the pole may touch
    ground: Annotated[float, Range(-1e9, 1e9, "m")] = 0.0


@settings
class RewardWeights:
    """Weights of the terms of the reward, see `quadpend_gym.tasks.rewards`; they are divided by their sum."""

    tracking: Annotated[float, Range(0.0, 1e6)] = 0.6  # weight of a small tracking error
    # weight of a pendulum near upright (or hanging, see `Task.pendulum`)
    upright: Annotated[float, Range(0.0, 1e6)] = 0.15
    yaw: Annotated[float, Range(0.0, 1e6)] = 0.1  # weight of a small yaw error
    effort: Annotated[float, Range(0.0, 1e6)] = 0.15  # weight of small actions
    tip: Annotated[float, Range(0.0, 1.0)] = 0.5  # s, share of the narrow peak in the tracking term
    # p, from 0 to 1: how much all terms vanish while the pendulum is on the wrong side or spins
    pendulum_first: Annotated[float, Range(0.0, 1.0)] = 0.0
    # q, from 0 to 1: how much all terms vanish while the action changes fast
    action_rate: Annotated[float, Range(0.0, 1.0)] = 0.0

    def __post_init__(self) -> None:
        if not (self.tracking or self.upright or self.yaw or self.effort):
            raise ValueError("one of the reward weights must be above zero")


@settings
class Task:
    """Task: references, random starts, termination limits, reward weights, and the side of the pendulum."""

    references: ReferenceSettings = ReferenceSettings()
    start: StartSettings = StartSettings()
    limits: Limits = Limits()
    reward: RewardWeights = RewardWeights()
    trajectory: Annotated[Any, TrajectoryField] = None  # of every episode; None: each draws one from `references`
    jumps: Jumps | None = None  # of the reference; None: it does not jump
    pendulum: Literal["upright", "hanging"] = "upright"  # starts, limit and reward are relative to this side

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


# annotation of a field that holds a task: from itself, its name, or a mapping of its fields
TaskField = Parsed(
    lambda value: look_up(TASKS, value, "task") if isinstance(value, str) else parse(Task, value, "task"),
    lambda: Literal[tuple(TASKS)] | Task,
)
