"""The reward: bounded named terms, sensitive to small errors; ending an episode early does not increase the return."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_are

from quadpend_gym import PAPER, QuadPendulumEnv, Reference, RewardWeights, State, read_observation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_gym.vehicles import CONTROL_PERIOD
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec, run_actions
from tests.helpers.physics import simulate_period

COMMAND_SCALE = np.array([PAPER.hover_thrust, 5.0, 5.0, 1.0])  # N and N·m
HEIGHT = Reference.hover().offset[2]
Actor = Callable[[State, int], Any]


def reward_at(action: Any = (0.0, 0.0, 0.0, 0.0), **start: Any) -> tuple[float, dict[str, float]]:
    """Return the reward and its terms after one step; all fields that `start` does not have are those of hovering."""
    env = make_unwrapped(task=ENDLESS)
    env.reset(seed=0, options={"state": {**AT_REST, **start}, "reference": Reference.hover()})
    _, reward, _, _, info = env.step(action)
    return reward, info["reward_terms"]


def test_exact_tracking_with_zero_action_has_reward_one() -> None:
    assert_allclose(reward_at()[0], 1.0, atol=1e-12)


@pytest.mark.parametrize(
    "deviation",
    [
        {"position": (1e-3, 0.0, HEIGHT)},
        {"position": (0.0, 0.0, HEIGHT - 1e-3)},
        {"direction": (0.03, 0.0, 1.0), "position": (-0.009, 0.0, HEIGHT)},
        {"euler": (0.0, 0.0, 0.02)},
        {"action": (0.05, 0.0, 0.0, 0.0)},
        {"action": (0.0, 0.0, 0.0, -0.05)},
    ],
    ids=["beside", "below", "tilted pendulum", "yawed", "thrust", "yaw torque"],
)
def test_every_deviation_has_a_reward_below_one(deviation: dict[str, Any]) -> None:
    assert reward_at(**deviation)[0] < 1.0 - 1e-4


def test_the_rewards_of_one_millimetre_and_one_centimetre_of_error_differ() -> None:
    for axis in (0, 2):
        millimetre, centimetre = (reward_at(position=np.eye(3)[axis] * e + (0, 0, HEIGHT))[0] for e in (1e-3, 1e-2))
        assert millimetre - centimetre >= 0.03


def test_the_reward_decreases_strictly_with_the_error() -> None:
    errors = np.geomspace(1e-4, 100.0, 60)
    reward = [reward_at(position=(error, 0.0, HEIGHT))[0] for error in errors]
    assert (np.diff(reward) < 0.0).all()


@pytest.mark.parametrize("tip", [0.0, 0.2, 0.5, 1.0])
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


@pytest.mark.parametrize("wind", [None, WINDY], ids=["calm", "windy"])
def test_the_reward_is_the_weighted_mean_of_bounded_terms(wind: Any) -> None:
    weights, names = RewardWeights(), ("tracking", "upright", "yaw", "effort")
    env = make_vec(200, wind=wind, task=ENDLESS)
    env.reset(seed=0)
    for _, reward, _, _, info in run_actions(env, draw_actions(0, 100, 200)):
        terms = info["reward_terms"]
        mean = sum(getattr(weights, name) * terms[name] for name in names)
        assert_allclose(reward, mean, rtol=1e-12)
        for value in (reward, *(terms[name] for name in names)):
            assert ((value >= 0.0) & (value <= 1.0)).all()


# Columns of the state that the regulator uses: all but r_z and ṙ_z, which follow from the others.
FREE = [i for i in range(STATE_SIZE) if i not in (DIRECTION + 2, DIRECTION_RATE + 2)]


def next_deviation(deviation: Floats, action: Floats) -> Floats:
    """Return the deviations from hovering one control period later, shape (n, 16)."""
    state = np.zeros((len(deviation), STATE_SIZE))
    state[:, FREE] = deviation
    direction = State(state).direction
    direction[:, 2] = np.sqrt(1.0 - np.sum(direction[:, :2] ** 2, axis=-1))
    command = COMMAND_SCALE * (action + np.eye(4)[0])
    return simulate_period(state, command, np.zeros(DISTURBANCE_SIZE), PAPER, CONTROL_PERIOD, 2)[:, FREE]


@cache
def gain() -> Floats:
    """Return the gain of the linear–quadratic regulator at hover from central differences, shape (4, 16)."""
    step, eye = 1e-5, np.eye(20)
    sides = [next_deviation(sign * step * eye[:, :16], sign * step * eye[:, 16:]) for sign in (1.0, -1.0)]
    jacobian = ((sides[0] - sides[1]) / (2.0 * step)).T
    a, b = jacobian[:, :16], jacobian[:, 16:]
    q, r = np.diag([10.0] * 3 + [1.0] * 13), np.eye(4)
    p = solve_discrete_are(a, b, q, r)
    return np.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a))


def balance(state: State, goal: Any = (0.0, 0.0, HEIGHT)) -> Floats:
    """Return the action of the regulator for a position."""
    hover = State(np.zeros(STATE_SIZE))
    hover.position[:], hover.direction[:] = goal, (0.0, 0.0, 1.0)
    deviation = state.array - hover.array
    return np.asarray(np.clip(-gain() @ deviation[FREE], -1.0, 1.0))


def mean_return_and_length(actor: Actor) -> tuple[float, int]:
    """Return the mean return and the mean length of ten hover episodes."""
    env = gym.make("QuadPendulumHover-v0")
    bare = env.unwrapped
    assert isinstance(bare, QuadPendulumEnv)
    earned, steps = 0.0, 0
    for episode in range(10):
        env.reset(seed=episode)
        over, step = False, 0
        while not over:
            _, reward, terminated, truncated, _ = env.step(actor(bare.state, step))
            earned, step, over = earned + float(reward), step + 1, terminated or truncated
        steps += step
    return earned / 10, steps // 10


@cache
def balancing_result() -> tuple[float, int]:
    """Return the mean return and the mean length of episodes with the regulator."""
    return mean_return_and_length(lambda state, _: balance(state))


def test_balancing_lasts_the_whole_episode_and_has_almost_the_maximal_return() -> None:
    earned, steps = balancing_result()
    assert steps == EPISODE_STEPS
    assert earned > 900.0


def random_action(state: State, step: int) -> Any:
    """Return a random action that depends on the step only."""
    return np.random.default_rng(step).uniform(-1.0, 1.0, 4)


EXPLOITS: dict[str, Actor] = {
    "do nothing": lambda state, step: np.zeros(4),
    "drop": lambda state, step: np.array([-1.0, 0.0, 0.0, 0.0]),
    "move away upwards": lambda state, step: np.array([1.0, 0.0, 0.0, 0.0]),
    "move away sideways": lambda state, step: np.array([0.0, 0.0, 1.0, 0.0]),
    "spin": lambda state, step: np.array([0.0, 0.0, 0.0, 1.0]),
    "spin while balancing": lambda state, step: np.append(balance(state)[:3], 1.0),
    "land gently while balancing": lambda state, step: balance(state, (0.0, 0.0, HEIGHT - 0.005 * step)),
    "move away slowly while balancing": lambda state, step: balance(state, (0.005 * step, 0.0, HEIGHT)),
    "balance two metres away": lambda state, step: balance(state, (2.0, 0.0, HEIGHT)),
    "random": random_action,
}


@pytest.mark.parametrize("actor", EXPLOITS.values(), ids=EXPLOITS.keys())
def test_the_return_of_every_exploit_is_much_lower_than_that_of_balancing(actor: Actor) -> None:
    assert mean_return_and_length(actor)[0] < 0.6 * balancing_result()[0]


def test_balancing_longer_has_a_higher_return() -> None:
    """An episode that ends early loses the rewards of its remaining steps."""

    def stop_balancing_at(last: int) -> Actor:
        return lambda state, step: balance(state) if step < last else np.array([-1.0, 0.0, 0.0, 0.0])

    earned = [mean_return_and_length(stop_balancing_at(last))[0] for last in (0, 100, 300, 600)]
    assert (np.diff(earned) > 50.0).all()
    assert earned[-1] < balancing_result()[0]
