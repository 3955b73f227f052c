"""A wind model of the user's own code is given as an object or as a text "module:factory"."""

import pickle
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from quadpend_gym import OrnsteinUhlenbeck
from quadpend_gym.wind import as_wind
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


def test_a_factory_that_returns_nothing_and_a_module_that_ends_the_program_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forgetful = write_module(tmp_path, monkeypatch, "def wind():\n    pass\n")
    with pytest.raises(ValueError, match=f"{forgetful}:wind must return a wind model: it returns None"):
        as_wind(f"{forgetful}:wind")
    ending = write_module(tmp_path, monkeypatch, "import sys\nsys.exit(3)\n")
    with pytest.raises(ValueError, match=f"the module of '{ending}:wind' cannot be imported .* SystemExit: 3"):
        as_wind(f"{ending}:wind")
