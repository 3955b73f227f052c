"""Tasks with a hanging pendulum, with a swing-up, and with random directions at the start."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import Limits, Reference, RewardWeights, StartSettings
from quadpend_gym.tasks.task import TASKS
from tests.helpers.envs import AT_REST, make_unwrapped, make_vec, run_actions

HANGING = {**AT_REST, "direction": (0.0, 0.0, -1.0)}


def test_starts_are_turned_by_angles_that_are_uniform_on_the_sphere() -> None:
    start = StartSettings(direction_rate=1.0, pendulum_angle=(0.5, 2.5))
    env = make_vec(20_000, task=replace(TASKS["hover"], start=start, limits=Limits(pendulum_angle=np.pi)))
    env.reset(seed=0)
    r, rate = env.state.direction, env.state.direction_rate
    assert_allclose(np.linalg.norm(r, axis=1), 1.0, rtol=1e-14)
    assert_allclose(np.sum(r * rate, axis=1), 0.0, atol=1e-14)
    cosine = np.sort(r[:, 2])
    low, high = np.cos(2.5), np.cos(0.5)
    assert_allclose([cosine[0], cosine[-1]], [low, high], atol=0.04)  # the deviation of r is up to 0.03
    assert np.abs(cosine - np.linspace(low, high, cosine.size)).max() < 0.03
    side = np.arctan2(r[:, 1], r[:, 0])
    assert np.abs(np.sort(side) - np.linspace(-np.pi, np.pi, side.size)).max() < 0.06


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0])
@pytest.mark.parametrize(("share", "rate"), [(0.0, 3.0), (0.4, 0.0), (1.0, 0.0), (1.0, 3.0)])
@pytest.mark.parametrize(("pendulum", "side"), [("upright", 1.0), ("hanging", -1.0)])
def test_the_reward_follows_the_equation(angle: float, share: float, rate: float, pendulum: str, side: float) -> None:
    task = replace(TASKS["swing_up"], reward=RewardWeights(pendulum_first=share), pendulum=pendulum)
    env = make_unwrapped(task=task)
    start = {"direction": (np.sin(angle), 0.0, side * np.cos(angle)), "direction_rate": (0.0, rate, 0.0)}
    env.reset(seed=0, options={"state": {**HANGING, **start}, "reference": Reference.hover()})
    _, reward, _, _, info = env.step((0.0, 0.0, 0.0, 0.0))
    terms, cosine = info["reward_terms"], np.cos(info["tilt"])
    reached = (1.0 + cosine) ** 2 / 4.0 / (1.0 + np.sum(env.state.direction_rate**2) / 25.0)
    mean = 0.6 * terms["tracking"] + 0.15 * terms["upright"] + 0.1 * terms["yaw"] + 0.15 * terms["effort"]
    assert_allclose(info["tilt"], angle, atol=0.04)  # of the side on which the task wants the pendulum
    assert_allclose(terms["upright"], max(cosine, 0.0) ** 2, rtol=1e-6)
    assert_allclose(reward, (1.0 - share + share * reached) * mean, rtol=1e-6)


@pytest.mark.parametrize(
    ("task", "angle", "ends"), [("load", 1.2, True), ("load", 0.9, False), ("swing_up", 1.2, False)]
)
def test_the_limit_of_the_pendulum_is_relative_to_its_side(task: str, angle: float, ends: bool) -> None:
    """At 69° from hanging, where the limit is 60°, and at 52°."""
    env = make_unwrapped(task=task)
    start = {**HANGING, "direction": (np.sin(angle), 0.0, -np.cos(angle))}
    env.reset(seed=0, options={"state": start, "reference": Reference.hover()})
    assert env.step((0.0, 0.0, 0.0, 0.0))[2] == ends


@pytest.mark.parametrize(("name", "largest"), [("swing_up", 0.05), ("load", 0.75), ("recovery", 0.3), ("track", 0.3)])
def test_parking_spinning_and_flying_away_earn_little(name: str, largest: float) -> None:
    """The returns of constant actions, relative to that of a perfect flight."""
    for action in ((0, 0, 0, 0), (0, 0, 0, 1), (1, 0, 0, 0), (0, 0, 1, 0), (0.3, 0.5, 0.5, 0.5)):
        env = make_vec(20, task=name)
        env.reset(seed=0)
        active, earned = np.ones(20, np.bool_), np.zeros(20)
        for _, reward, terminated, truncated, _ in run_actions(env, np.tile(np.float32(action), (1000, 20, 1))):
            earned += reward * active
            active &= ~(terminated | truncated)
        assert earned.mean() < 1000.0 * largest, action
