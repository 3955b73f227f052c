"""Wind: it blows the same however it is attached, and changes nothing but what it acts on."""

import copy
import json
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Limits, OrnsteinUhlenbeck, Sinusoid, Task
from quadpend_gym.arrays import Floats, Integers
from quadpend_gym.dynamics import momentum
from quadpend_gym.kernel import advance
from quadpend_gym.streams import Streams
from quadpend_gym.wind import KINDS, PRESETS, Sum, Wind, as_wind
from quadpend_gym.wrappers import VectorWindWrapper, WindWrapper
from tests.env_helpers import ENDLESS, WINDY, assert_same, draw_actions, fly, make, make_bare, make_rows
from tests.test_bad_input import refused
from tests.wind_helpers import EXAMPLES, PERIOD, blown, chance, every_kind

every_preset = pytest.mark.parametrize("name", PRESETS)


def test_there_is_an_example_of_every_kind() -> None:
    assert {name: type(model) for name, model in EXAMPLES.items()} == KINDS
    for model in EXAMPLES.values():
        assert (blown(model, 20, 3) != 0.0).any(axis=(0, 2)).all()


def test_a_sum_is_the_sum_of_its_members() -> None:
    one, other = OrnsteinUhlenbeck(force=0.5), Constant(force=1.0, torque=0.1)
    assert_allclose(blown(one + other, 50, 4), blown(one, 50, 4) + blown(other, 50, 4), rtol=1e-15)
    assert_same(blown(one + other, 50, 4), blown(Sum((one, other)), 50, 4))
    assert_same(blown(one + (other + other), 50, 4), blown(one + other + other, 50, 4))


@every_kind
def test_adding_a_model_leaves_the_numbers_of_the_others_alone(wind: Any) -> None:
    first = Sinusoid(bob_force=0.5) + wind
    for added in EXAMPLES.values():
        alone = blown(Sum((Constant(), Constant(), added)) if wind is not EXAMPLES["sum"] else 4 * (Constant(),), 3, 2)
        assert alone.shape == (3, 2, 12)
    assert_array_equal(blown(first + OrnsteinUhlenbeck(force=0.0, torque=0.1), 50, 4)[..., :6], blown(first, 50, 4)[..., :6])


def test_equal_models_in_a_sum_blow_independently() -> None:
    wind = OrnsteinUhlenbeck(force=0.5)
    assert_allclose(blown(wind + wind, 1, 5000).std(axis=1)[0, :3], 0.5 * np.sqrt(2.0), rtol=0.04)


def test_every_row_and_every_episode_has_a_wind_of_its_own() -> None:
    env = make_rows(3, wind=WINDY)
    seen = []
    for seed in (0, None, None):
        env.reset(seed=seed)
        seen += list(env.step(np.zeros((3, 4)))[4]["disturbance"][:, 0])
    assert len(set(seen)) == 9
