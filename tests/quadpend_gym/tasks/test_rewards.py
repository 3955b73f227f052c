"""The reward follows its equations, is sensitive to small errors, and never favours an early end."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import Reference, RewardWeights, read_observation
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec, run_actions

HEIGHT = Reference.hover().offset[2]


def reward_at(action: Any = (0.0, 0.0, 0.0, 0.0), **start: Any) -> float:
    """Return the reward of one step; all fields that `start` does not have are those of hovering."""
    env = make_unwrapped(task=ENDLESS)
    env.reset(seed=0, options={"state": {**AT_REST, **start}, "reference": Reference.hover()})
    return env.step(action)[1]


@pytest.mark.parametrize(
    "deviation",
    [
        {"position": (0.0, 0.0, HEIGHT - 1e-3)},
        {"direction": (0.03, 0.0, 1.0), "position": (-0.009, 0.0, HEIGHT)},
        {"euler": (0.0, 0.0, 0.02)},
        {"action": (0.05, 0.0, 0.0, 0.0)},
        {"action": (0.0, 0.0, 0.0, -0.05)},
    ],
    ids=["below", "tilted pendulum", "yawed", "thrust", "yaw torque"],
)
def test_exact_tracking_with_zero_action_has_reward_one_and_every_deviation_less(deviation: dict[str, Any]) -> None:
    assert_allclose(reward_at(), 1.0, atol=1e-12)
    assert reward_at(**deviation) < 1.0 - 1e-4


def test_the_reward_decreases_strictly_with_the_error_and_resolves_millimetres() -> None:
    rewards = [reward_at(position=(error, 0.0, HEIGHT)) for error in (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)]
    assert (np.diff(rewards) < 0.0).all()
    assert rewards[1] - rewards[2] >= 0.03


@pytest.mark.parametrize("tip", [0.0, 0.5, 1.0])
def test_the_terms_follow_the_equations(tip: float) -> None:
    """The default weight of the narrow peak is one half."""
    env = make_unwrapped(task=replace(ENDLESS, reward=RewardWeights() if tip == 0.5 else RewardWeights(tip=tip)))
    env.reset(seed=0)
    for action in draw_actions(0, 30):
        observation, _, _, _, info = env.step(action)
        error = np.linalg.norm(info["tracking_error"])
        yaw_error = read_observation(observation, "attitude")[2]
        expected = {
            "tracking": (1.0 - tip) / (1.0 + (error / 0.3) ** 2) + tip / (1.0 + error / 0.02),
            "upright": max(env.state.direction[2], 0.0) ** 2,
            "yaw": 1.0 / (1.0 + (yaw_error / 0.2) ** 2),
            "effort": 1.0 / (1.0 + np.sum(action.astype(np.float64) ** 2)),
        }
        assert expected.keys() == info["reward_terms"].keys()
        for name, value in expected.items():
            assert_allclose(info["reward_terms"][name], value, rtol=1e-6, err_msg=name)


def test_the_reward_is_the_weighted_mean_of_terms_in_0_to_1() -> None:
    """No term is negative, so an early end loses the rewards of the remaining steps."""
    names = ("tracking", "upright", "yaw", "effort")
    for weights in (RewardWeights(), RewardWeights(1.0, 2.0, 3.0, 4.0)):
        env = make_vec(200, wind=WINDY, task=replace(ENDLESS, reward=weights))
        env.reset(seed=0)
        for _, reward, _, _, info in run_actions(env, draw_actions(0, 50, 200)):
            terms = np.array([info["reward_terms"][name] for name in names])
            assert_allclose(reward, np.average(terms, 0, [getattr(weights, name) for name in names]), rtol=1e-12)
            assert 0.0 <= terms.min() <= terms.max() <= 1.0
