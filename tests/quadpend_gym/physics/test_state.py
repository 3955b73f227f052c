"""The named views cover their arrays in order, and the single numbers that compiled functions read agree with them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_gym import Disturbance, Parameters, State
from quadpend_gym.physics.state import DISTURBANCE_FIELDS, DISTURBANCE_SIZE, STATE_FIELDS, STATE_SIZE
from quadpend_gym.vehicles import parameters

LAYOUTS = pytest.mark.parametrize(
    ("view", "fields", "size"),
    [(State, STATE_FIELDS, STATE_SIZE), (Disturbance, DISTURBANCE_FIELDS, DISTURBANCE_SIZE)],
    ids=["State", "Disturbance"],
)


@LAYOUTS
def test_the_views_cover_the_array_in_order(view: type[Any], fields: Mapping[str, slice], size: int) -> None:
    array = np.arange(2.0 * size).reshape(2, size)
    assert_array_equal(np.concatenate([getattr(view(array), name) for name in fields], axis=-1), array)


@LAYOUTS
def test_writing_into_a_view_writes_into_the_array(view: type[Any], fields: Mapping[str, slice], size: int) -> None:
    array = np.zeros((2, size))
    for number, name in enumerate(fields, start=1):
        getattr(view(array), name)[:] = number
    assert_array_equal(array, np.tile(np.repeat(np.arange(1, size // 3 + 1), 3), (2, 1)))


def test_parameters_of_compiled_functions_have_their_positions_in_the_array() -> None:
    array = Parameters(*np.arange(1.0, parameters.PARAMETERS_SIZE + 1)).as_array()
    for number, name in enumerate(parameters.PARAMETER_NAMES[:3], start=1):
        assert array[getattr(parameters, name.upper())] == number
