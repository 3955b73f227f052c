"""Tasks: references to track, random starts, rewards, limits and the observation, all as data."""

from quadpend_gym.tasks.task import (
    TASKS,
    Limits,
    ReferenceSettings,
    RewardWeights,
    StartSettings,
    Task,
    as_task,
    flatten,
)

__all__ = [
    "TASKS",
    "Limits",
    "ReferenceSettings",
    "RewardWeights",
    "StartSettings",
    "Task",
    "as_task",
    "flatten",
]
