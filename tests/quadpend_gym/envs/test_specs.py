"""The specification of an environment survives conversion to JSON and makes the same environment."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec

from quadpend_gym import Limits, ReferenceSettings, Task
from quadpend_gym.tasks.task import ENVIRONMENTS, TASKS
from tests.helpers.envs import WINDY, assert_same, draw_actions, make, make_vec, run_actions

TASK = Task(references=ReferenceSettings(hover=0.0, height=(3.0, 4.0)), limits=Limits(tracking_error=0.5))
LOOP = {"vehicle": "hummingbird", "interface": "body_rates", "latency": 0.02, "period": 0.02, "substeps": 3}
SETTINGS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "a sum of winds": {"wind": WINDY},
    "a task by name": {"task": "hover"},
    "a task": {"task": TASK},
    "a vehicle and its loop": LOOP,
    "a scenario": {"scenario": "noisy"},
    "a time limit": {"max_episode_steps": 7},
    "all": {"wind": WINDY, "task": TASK, **LOOP, "max_episode_steps": 7},
}
settings = pytest.mark.parametrize("kwargs", SETTINGS.values(), ids=SETTINGS.keys())


def through_json(spec: EnvSpec | None) -> EnvSpec:
    """Return the specification after conversion to JSON and back."""
    assert spec is not None
    return EnvSpec.from_json(spec.to_json())


@settings
def test_spec_survives_json(kwargs: dict[str, Any]) -> None:
    env, rows = make(**kwargs), make_vec(3, autoreset_mode="SameStep", **kwargs)
    pairs = (env, gym.make(through_json(env.spec)), ()), (rows, gym.make_vec(through_json(rows.spec)), (3,))
    for one, duplicate, shape in pairs:
        assert_same(duplicate.reset(seed=3), one.reset(seed=3))
        actions = draw_actions(3, 10, *shape)
        assert_same(run_actions(duplicate, actions), run_actions(one, actions))


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_a_mapping_changes_the_task_of_the_id(env_id: str) -> None:
    own = TASKS[ENVIRONMENTS[env_id]]
    env: Any = gym.make(env_id, task={"reward": {"effort": 0.3}}).unwrapped
    assert env.scenario.task == replace(own, reward=replace(own.reward, effort=0.3))
    env = gym.make(env_id, scenario="windy").unwrapped
    assert env.scenario.task == own
