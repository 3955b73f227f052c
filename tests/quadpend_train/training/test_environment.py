"""The training environment gives a policy what evaluation gives it."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_array_equal

from quadpend_gym.scenarios import find_scenario
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import HybridSettings, TrainSettings
from tests.helpers.policies import mlp_policy
from tests.helpers.training import BRIEF

DELAYED = {"wind": "breeze", "sensors": {"kind": "delay", "steps": 3}}


def observed_in_training(policy: Any, settings: TrainSettings, steps: int) -> Any:
    env = make_env(settings)
    env.seed(5)
    observed = [env.reset()]
    for _ in range(steps):
        pairs = np.split(observed[-1], 2)  # the rounding of a matrix product may depend on the number of rows
        observed.append(env.step(np.concatenate([policy.forward(pair) for pair in pairs]))[0])
    return observed[:-1]


@pytest.mark.parametrize(
    ("mode", "scenario"),
    [
        ("estimate_only", "training_lagged"),
        ("estimate_only", json.dumps({**DELAYED, "loop_known": False})),
        ("residual_action", json.dumps(DELAYED)),
    ],
)
def test_policy_observes_in_training_what_it_observes_in_evaluation(mode: Any, scenario: str) -> None:
    """Also in the second of two scenarios, of which only this one has delays that the base controller knows."""
    settings = replace(BRIEF, scenarios=("calm", scenario), num_envs=4, hybrid=HybridSettings("flatness", mode))
    policy = mlp_policy(49 if mode == "residual_action" else 45, **settings.policy_interface())
    expected = observed_in_training(policy, settings, 40)
    env: Any
    adapted: Any
    adapted, env = policy.adapt(found := find_scenario(scenario)), found.make_vec(2, AutoresetMode.SAME_STEP)
    observation, memory, started = env.reset(seed=7)[0], None, np.ones(2, np.bool_)  # rows 2 and 3 of the training
    for seen in expected:
        assert_array_equal(adapted.hybrid.observe(observation, memory, started)[0], seen[2:])
        action, memory = adapted.predict(observation, memory, started)
        observation, _, terminated, truncated, _ = env.step(action)
        started = terminated | truncated
