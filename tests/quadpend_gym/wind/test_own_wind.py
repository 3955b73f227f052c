"""A wind model of the user's own code is given as an object or as a text "module:factory"."""

import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from quadpend_gym import OrnsteinUhlenbeck
from quadpend_gym.wind import as_wind
from quadpend_gym.wrappers import WindWrapper
from tests.helpers.envs import assert_same, draw_actions, make, run_actions
from tests.helpers.own_code import write_module
from tests.helpers.wind import sample_wind

CODE = """
from quadpend_gym import Dryden, Gusts, OrnsteinUhlenbeck

def one():
    return OrnsteinUhlenbeck(0.3)

def several():
    return Dryden("moderate") + Gusts(velocity=(6.0, 0.0, 0.0))

def number():
    return 3

def failing():
    return {}["x"]

table = {}
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    return write_module(tmp_path, monkeypatch, CODE)


def test_a_wind_by_its_factory_is_the_wind_that_the_factory_returns(module: str) -> None:
    for wind in (f"{module}:one", {"kind": f"{module}:one"}):
        np.testing.assert_array_equal(sample_wind(wind, 30, 3), sample_wind(OrnsteinUhlenbeck(0.3), 30, 3))
    (several,) = as_wind(f"{module}:several")
    assert several.moves_air
    wind = sample_wind(several, 400, 3)
    assert np.abs(wind[..., 9:]).max() > 1.0
    np.testing.assert_array_equal(sample_wind(pickle.loads(pickle.dumps(several)), 400, 3), wind)


def test_the_specification_keeps_the_factory_of_a_wind(module: str) -> None:
    env = WindWrapper(make(wind=f"{module}:one"), f"{module}:several")
    assert env.spec is not None
    duplicate = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert_same(duplicate.reset(seed=3), env.reset(seed=3))
    actions = draw_actions(3, 10)
    assert_same(run_actions(duplicate, actions), run_actions(env, actions))


@pytest.mark.parametrize(
    ("wind", "message"),
    [
        ("number", "number must return a wind model: wind must be .*, not 3"),
        ("failing", r"failing failed: KeyError: 'x' \(own_code_\d+\.py, line 14\)"),
        ("sevral", r"has no 'sevral' \(did you mean 'several'\?\)"),
        ("table", "table must be a function or a class, not {}"),
    ],
)
def test_a_bad_factory_of_a_wind_is_refused(wind: str, message: str, module: str) -> None:
    with pytest.raises(ValueError, match=message):
        as_wind(f"{module}:{wind}")


def test_a_module_that_cannot_be_imported_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = write_module(tmp_path, monkeypatch, "import nowhere_to_be_found")
    with pytest.raises(ValueError, match="the module of 'missing_module:wind' cannot be imported"):
        as_wind("missing_module:wind")
    with pytest.raises(ValueError, match=r"cannot be imported .*ModuleNotFoundError: No module named 'nowhere_to_be"):
        as_wind(f"{name}:wind")
