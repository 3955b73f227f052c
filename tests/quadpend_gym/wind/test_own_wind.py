"""A wind model of the user's own code is given as an object or as a text "module:factory"."""

import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import Constant, OrnsteinUhlenbeck
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind import Wind, as_wind
from tests.helpers.envs import make_vec
from tests.helpers.own_code import write_module
from tests.helpers.wind import sample_wind

CODE = """
from quadpend_gym import Dryden, Gusts, OrnsteinUhlenbeck

def one():
    return OrnsteinUhlenbeck(0.3)

def several():
    return Dryden("moderate") + Gusts(velocity=(6.0, 0.0, 0.0))
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    return write_module(tmp_path, monkeypatch, CODE)


def test_a_wind_by_its_factory_is_the_wind_that_the_factory_returns(module: str) -> None:
    for wind in (f"{module}:one", {"kind": f"{module}:one"}):
        assert_array_equal(sample_wind(wind, 30, 3), sample_wind(OrnsteinUhlenbeck(0.3), 30, 3))
    (several,) = as_wind(f"{module}:several")
    assert several.moves_air
    assert_array_equal(sample_wind(pickle.loads(pickle.dumps(several)), 30, 3), sample_wind(several, 30, 3))


@dataclass(frozen=True)
class Ramp:
    """A force in x that grows linearly in time from a random value."""

    slope: float = 1.0
    memory_size: int = 1
    moves_air: bool = False

    def initial_memory(self, streams: Streams) -> Floats:
        return streams.uniform(0, 1)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        out[:, 0] += memory[:, 0]
        memory[:, 0] += self.slope * period


def test_a_wind_needs_no_base_class() -> None:
    assert isinstance(Ramp(), Wind)
    env = make_vec(3, wind=[Ramp(), Constant(torque=0.1)])
    env.reset(seed=0)
    force = [env.step(np.zeros((3, 4)))[4]["disturbance"][:, 0] for _ in range(10)]
    assert_allclose(np.diff(force, axis=0), 0.01, rtol=1e-12)
    assert len(set(force[0])) == 3


def test_a_factory_that_returns_nothing_and_a_module_that_ends_the_program_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forgetful = write_module(tmp_path, monkeypatch, "def wind():\n    pass\n")
    with pytest.raises(ValueError, match=f"{forgetful}:wind must return a wind model: it returns None"):
        as_wind(f"{forgetful}:wind")
    ending = write_module(tmp_path, monkeypatch, "import sys\nsys.exit(3)\n")
    with pytest.raises(ValueError, match=f"the module of '{ending}:wind' cannot be imported .* SystemExit: 3"):
        as_wind(f"{ending}:wind")
