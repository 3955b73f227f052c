"""A network with a history flies beside policies without one, and its history is found from its size."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sb3_contrib import CrossQ
from stable_baselines3 import PPO

from quadpend_gym.scenarios import Scenario
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.evaluation.comparison import compare
from quadpend_train.policies.conversion import policy_from_function
from quadpend_train.policies.export import export_zip
from quadpend_train.policies.history import History, histories_of
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import MlpPolicy
from tests.helpers.bad_input import assert_refused
from tests.helpers.controllers import run_policy
from tests.helpers.envs import make_vec
from tests.helpers.wrappers import OUTPUTS, SHORT, make_wrapped_vec

BRIEF = {"wind": "windy", "autoreset_mode": "SameStep", **SHORT}


def trained(kind: Any, path: Path, **options: Any) -> Any:
    """Save an agent that was trained for a few steps behind a wrapper, and return it."""
    env = SB3VecEnv(VectorHistoryWrapper(make_vec(2, autoreset_mode="SameStep"), 2, 2))
    model = kind("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, seed=0, device="cpu", **options).learn(8)
    model.save(path)
    return model


@pytest.mark.parametrize(
    ("kind", "options"), [(PPO, {"n_steps": 4, "batch_size": 8}), (CrossQ, {"buffer_size": 8})], ids=["PPO", "CrossQ"]
)
def test_a_model_of_plain_sb3_with_a_history_flies_as_behind_the_wrapper(
    kind: Any, options: Any, tmp_path: Path
) -> None:
    """Exported or run by its own `predict`; episodes end at another time in each sub-environment."""
    model = trained(kind, tmp_path / "model.zip", **options)
    policy = load_policy(str(tmp_path / "model.zip"))
    assert isinstance(policy, MlpPolicy) == (kind is PPO)
    assert len(compare({"lqr": "lqr", "own": policy}, {"brief": Scenario(duration=0.05)}, 2).summaries) == 2
    actions, _ = run_policy(policy, make_vec(3, **BRIEF), 60)
    env = VectorHistoryWrapper(make_vec(3, **BRIEF), 2, 2)
    observation, _ = env.reset(seed=5)
    for action in actions:
        assert_allclose(action, model.predict(observation, deterministic=True)[0], atol=1e-5)
        observation, *_ = env.step(action)


def test_a_function_may_have_a_history() -> None:
    seen: list[Any] = []
    policy = policy_from_function(lambda rows: seen.append(rows) or 0.1 * rows[:, :4], history=2, history_actions=1)
    first, second = np.random.default_rng(0).normal(size=(2, 3, 36)).astype(np.float32)
    action, memory = policy.predict(first)
    again, _ = policy.predict(second, memory, np.array([False, False, True]))
    assert_array_equal(seen[0], np.hstack([first, first, np.zeros((3, 4))]))
    assert_array_equal(seen[1][:2], np.hstack([first, second, action])[:2])
    assert_array_equal(seen[1][2], np.hstack([second, second, np.zeros((3, 4))])[2])
    assert_allclose(again, np.clip(0.1 * seen[1][:, :4], -1.0, 1.0))


def test_the_size_of_an_observation_says_its_history() -> None:
    assert histories_of(36) == [History(36, 1, 0)]
    assert histories_of(27 * 3 + 8) == [History(27, 3, 2)]
    assert histories_of(36 + 32) == [History(36, 1, 8)]
    assert histories_of(108) == [History(36, 3, 0), History(27, 4, 0)]
    assert histories_of(45) == histories_of(3) == []


def test_three_whole_observations_or_four_without_velocities_need_a_history(tmp_path: Path) -> None:
    path, history = tmp_path / "model.zip", lambda env: VectorHistoryWrapper(env, 4)
    env = SB3VecEnv(history(make_wrapped_vec(2, [OUTPUTS], autoreset_mode="SameStep")))
    model: Any = PPO("MlpPolicy", env, n_steps=4, batch_size=8, device="cpu")
    model.save(path)
    assert_refused(lambda: load_policy(str(path)), "where several fit, .*--history", ValueError)
    assert export_zip(path, history=4).observation_sizes == (27,)
    assert export_zip(path, history=3).observation_sizes == (36,)
