"""The reward: bounded named terms, steep at the goal, and never worth ending an episode for."""

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
from quadpend_gym.physics.kernel import advance
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec, run_actions

FULL = np.array([PAPER.hover_thrust, 5.0, 5.0, 1.0])  # of the actuators, N and N·m
HEIGHT = Reference.hover().offset[2]
Pilot = Callable[[State, int], Any]


def reward_at(action: Any = (0.0, 0.0, 0.0, 0.0), **start: Any) -> tuple[float, dict[str, float]]:
    """Reward and its terms after a step from rest, but for `start`, at the hovering point."""
    env = make_unwrapped(task=ENDLESS)
    env.reset(seed=0, options={"state": {**AT_REST, **start}, "reference": Reference.hover()})
    _, reward, _, _, info = env.step(action)
    return reward, info["reward_terms"]


def test_perfect_still_tracking_earns_one() -> None:
    assert_allclose(reward_at()[0], 1.0, atol=1e-12)


@pytest.mark.parametrize(
    "flaw",
    [
        {"position": (1e-3, 0.0, HEIGHT)},
        {"position": (0.0, 0.0, HEIGHT - 1e-3)},
        {"direction": (0.03, 0.0, 1.0), "position": (-0.009, 0.0, HEIGHT)},
        {"euler": (0.0, 0.0, 0.02)},
        {"action": (0.05, 0.0, 0.0, 0.0)},
        {"action": (0.0, 0.0, 0.0, -0.05)},
    ],
    ids=["beside", "below", "leaning", "turned", "thrusting", "twisting"],
)
def test_nothing_less_earns_one(flaw: dict[str, Any]) -> None:
    assert reward_at(**flaw)[0] < 1.0 - 1e-4


def test_one_millimetre_and_one_centimetre_of_error_differ() -> None:
    for axis in (0, 2):
        millimetre, centimetre = (reward_at(position=np.eye(3)[axis] * e + (0, 0, HEIGHT))[0] for e in (1e-3, 1e-2))
        assert millimetre - centimetre >= 0.03


def test_less_error_always_earns_more() -> None:
    errors = np.geomspace(1e-4, 100.0, 60)
    earned = [reward_at(position=(error, 0.0, HEIGHT))[0] for error in errors]
    assert (np.diff(earned) < 0.0).all()


@pytest.mark.parametrize("tip", [0.0, 0.2, 0.5, 1.0])
def test_terms_are_those_of_the_equations(tip: float) -> None:
    """Half of the tracking term is its sharp tip if nobody says otherwise."""
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


# Coordinates for the regulator: the state without r_z and ṙ_z, which the unit vector leaves no freedom.
FREE = [*range(14), 15, 16]


def flown(deviation: Floats, action: Floats) -> Floats:
    """Deviations from hovering one control period later, shapes (n, 16) and (n, 4)."""
    state = np.zeros((len(deviation), 18))
    state[:, FREE] = deviation
    state[:, 14] = np.sqrt(1.0 - np.sum(state[:, 12:14] ** 2, axis=-1))
    command = FULL * (action + np.eye(4)[0])
    advance(state, command, np.zeros((len(state), 9)), np.repeat(PAPER.as_array()[np.newaxis], len(state), 0), 0.01, 2)
    return state[:, FREE]


@cache
def gain() -> Floats:
    """Linear–quadratic regulator of the sampled physics around hovering, by central differences, shape (4, 16)."""
    step, eye = 1e-5, np.eye(20)
    sides = [flown(sign * step * eye[:, :16], sign * step * eye[:, 16:]) for sign in (1.0, -1.0)]
    jacobian = ((sides[0] - sides[1]) / (2.0 * step)).T
    a, b = jacobian[:, :16], jacobian[:, 16:]
    q, r = np.diag([10.0] * 3 + [1.0] * 13), np.eye(4)
    p = solve_discrete_are(a, b, q, r)
    return np.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a))


def balance(state: State, goal: Any = (0.0, 0.0, HEIGHT)) -> Floats:
    """The regulator's action towards a goal."""
    deviation = state.array - np.concatenate([goal, np.zeros(11), [1.0], np.zeros(3)])
    return np.asarray(np.clip(-gain() @ deviation[FREE], -1.0, 1.0))


def total(pilot: Pilot) -> tuple[float, int]:
    """Mean return and length of ten hover episodes flown by a pilot."""
    env = gym.make("QuadPendulumHover-v0")
    bare = env.unwrapped
    assert isinstance(bare, QuadPendulumEnv)
    earned, steps = 0.0, 0
    for episode in range(10):
        env.reset(seed=episode)
        over, step = False, 0
        while not over:
            _, reward, terminated, truncated, _ = env.step(pilot(bare.state, step))
            earned, step, over = earned + float(reward), step + 1, terminated or truncated
        steps += step
    return earned / 10, steps // 10


@cache
def balanced() -> tuple[float, int]:
    """Return and length of balancing."""
    return total(lambda state, _: balance(state))


def test_balancing_lasts_and_earns_almost_everything() -> None:
    earned, steps = balanced()
    assert steps == 1000
    assert earned > 900.0


def at_random(state: State, step: int) -> Any:
    """Random actions, the same in every episode."""
    return np.random.default_rng(step).uniform(-1.0, 1.0, 4)


EXPLOITS: dict[str, Pilot] = {
    "do nothing": lambda state, step: np.zeros(4),
    "fall": lambda state, step: np.array([-1.0, 0.0, 0.0, 0.0]),
    "fly away upwards": lambda state, step: np.array([1.0, 0.0, 0.0, 0.0]),
    "fly away sidewards": lambda state, step: np.array([0.0, 0.0, 1.0, 0.0]),
    "spin": lambda state, step: np.array([0.0, 0.0, 0.0, 1.0]),
    "spin while balancing": lambda state, step: np.append(balance(state)[:3], 1.0),
    "land gently while balancing": lambda state, step: balance(state, (0.0, 0.0, HEIGHT - 0.005 * step)),
    "glide away while balancing": lambda state, step: balance(state, (0.005 * step, 0.0, HEIGHT)),
    "balance two metres away": lambda state, step: balance(state, (2.0, 0.0, HEIGHT)),
    "random": at_random,
}


@pytest.mark.parametrize("pilot", EXPLOITS.values(), ids=EXPLOITS.keys())
def test_every_exploit_earns_much_less_than_balancing(pilot: Pilot) -> None:
    assert total(pilot)[0] < 0.6 * balanced()[0]


def test_balancing_longer_earns_more() -> None:
    """Whenever one gives up, the rest of the episode's reward is lost."""

    def quit_at(last: int) -> Pilot:
        return lambda state, step: balance(state) if step < last else np.array([-1.0, 0.0, 0.0, 0.0])

    earned = [total(quit_at(last))[0] for last in (0, 100, 300, 600)]
    assert (np.diff(earned) > 50.0).all()
    assert earned[-1] < balanced()[0]
