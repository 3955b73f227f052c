"""Wind in environments: sums, independence of everything else, reproducibility, and consistency with `info`."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Hold, Limits, OrnsteinUhlenbeck, Sinusoid, State, StillAir, Task
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.wind import KINDS, Sum, as_wind
from tests.helpers.envs import (
    ENDLESS,
    WINDY,
    draw_actions,
    make_unwrapped,
    make_vec,
)
from tests.helpers.wind import EXAMPLES, PERIOD, every_kind, sample_wind

STORMY = WINDY + "storm" + Constant(velocity=(3.0, -4.0, 1.0))


def test_every_kind_has_an_example_that_is_non_zero_after_a_few_steps() -> None:
    assert {**{name: type(model) for name, model in EXAMPLES.items()}, "still_air": StillAir, "hold": Hold} == KINDS
    for model in EXAMPLES.values():
        assert (sample_wind(model, 10, 3) != 0.0).any(axis=(0, 2)).all()


def test_winds_are_added_from_either_side_and_by_sum() -> None:
    one, other = OrnsteinUhlenbeck(force=0.5), Sinusoid(force=1.0)
    assert "breeze" + one == Sum(("breeze", one))
    assert sum([one, other, other]) == one + other + other
    assert {"kind": "constant", "force": 0.1} + one == Sum((Constant(force=0.1), one))
    assert as_wind(["windy", one, None]) == (*as_wind("windy"), one)
    assert all(as_wind(nothing) == () for nothing in (None, "calm", (), Sum(), [None, "calm"]))


@every_kind
def test_adding_a_model_adds_its_wind_and_does_not_change_the_others(wind: Any) -> None:
    added = OrnsteinUhlenbeck(force=0.0, torque=(0.1, 0.0, 0.0))
    both, alone = sample_wind(wind + added, 50, 4), sample_wind(wind, 50, 4)
    assert (both != alone)[..., 6].all()
    assert_array_equal(np.delete(both, 6, axis=-1), np.delete(alone, 6, axis=-1))


def test_equal_models_in_a_sum_are_independent() -> None:
    wind = OrnsteinUhlenbeck(force=0.5)
    assert_allclose(sample_wind(wind + wind, 1, 5000).std(axis=1)[0, :3], 0.5 * np.sqrt(2.0), rtol=0.04)


def wind_by_episode(env: Any, row: int, actions: Any, episodes: int) -> list[list[bytes]]:
    """Return the wind in each step of the first episodes of a row of a vector environment with same-step autoreset."""
    winds: list[list[bytes]] = [[] for _ in range(episodes + 1)]
    for action in actions:
        if (episode := env.world.episode[row]) == episodes:
            break
        winds[episode].append(env.world.wind[row].tobytes())
        env.step(action)
    return winds[:-1]


@every_kind
def test_the_wind_of_episode_k_does_not_depend_on_policy_number_of_rows_or_episode_lengths(wind: Any) -> None:
    """With other actions, lengths and rows the wind is the same for as long as both episodes last."""
    results = []
    for rows, policy, tilt in ((1, 0, 0.4), (5, 1, 0.6)):
        task = Task(limits=Limits(body_angle=tilt))
        env = make_vec(rows, wind=wind, task=task, duration=0.2, autoreset_mode="SameStep")
        env.reset(seed=10 - (rows - 1))
        results.append(wind_by_episode(env, rows - 1, draw_actions(policy, 200, rows), 4))
    for one, other in zip(*results, strict=True):
        assert all(a == b for a, b in zip(one, other, strict=False))
    assert any(len(one) != len(other) for one, other in zip(*results, strict=True))
    if not isinstance(wind, Constant):  # different episodes have different winds
        assert len({episode[3] for episode in results[0]}) == len(results[0])


def momentum(state: State) -> Floats:
    """Return the linear momentum of both bodies in kg·m/s, world frame."""
    return np.asarray(PAPER.total_mass * state.velocity + PAPER.bob_mass * PAPER.rod_length * state.direction_rate)


@pytest.mark.parametrize("wind", [WINDY, STORMY], ids=["forces", "forces and moving air"])
def test_the_disturbance_in_info_determines_the_next_state(wind: Any) -> None:
    """The state and the momentum follow from the previous state, the action and `info["disturbance"]`."""
    env = make_unwrapped(task=ENDLESS, wind=wind)
    env.reset(seed=0)
    parameters = PAPER.as_array()[np.newaxis]
    for action in (*draw_actions(0, 5), *np.tile([-1.0, 0.0, 0.0, 0.0], (5, 1))):
        state, before = env.state.array[np.newaxis].copy(), momentum(env.state)
        disturbance = env.step(action)[4]["disturbance"]
        command = np.array([[PAPER.hover_thrust, 5.0, 5.0, 1.0]]) * (action + np.eye(4)[0])
        advance(state, command, disturbance[np.newaxis], parameters, PERIOD, 2)
        assert_allclose(env.state.array, state[0], atol=1e-14)
        if action[0] == -1.0:  # no thrust
            force = disturbance[0:3] + disturbance[3:6] - (0.0, 0.0, PAPER.hover_thrust)
            assert_allclose(momentum(env.state) - before, PERIOD * force, rtol=1e-9)
