"""Tasks: references to track, random starts, rewards, limits and the observation, all as data."""

from quadpend_gym.tasks.task import (
    EPISODE_STEPS,
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
    "EPISODE_STEPS",
    "TASKS",
    "Limits",
    "ReferenceSettings",
    "RewardWeights",
    "StartSettings",
    "Task",
    "as_task",
    "flatten",
]
