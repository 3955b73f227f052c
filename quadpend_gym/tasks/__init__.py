"""Tasks: reference trajectories, random starts, termination limits, rewards and the observation."""

from quadpend_gym.tasks.task import (
    ENVIRONMENTS,
    EPISODE_STEPS,
    TASKS,
    Limits,
    ReferenceSettings,
    RewardWeights,
    StartSettings,
    Task,
    TaskField,
    as_task,
    flatten,
)

__all__ = [
    "ENVIRONMENTS",
    "EPISODE_STEPS",
    "TASKS",
    "Limits",
    "ReferenceSettings",
    "RewardWeights",
    "StartSettings",
    "Task",
    "TaskField",
    "as_task",
    "flatten",
]
