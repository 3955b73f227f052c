"""Wrong input, and the check that the error message is one sentence."""

import copy
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers.envs import assert_same, draw_actions, run_actions

ERRORS = (TypeError, ValueError, gym.error.Error)


Table = dict[str, tuple[Any, Any, str]]  # value, type of the error, pattern of its message


ROWS = 3


ZEROS = np.zeros((ROWS, 4))


def assert_refused(call: Callable[[], Any], names: str, kind: Any = ERRORS) -> None:
    """Assert that `call` raises an error of type `kind` whose message is one line and matches `names`."""
    with pytest.raises(kind, match=names) as caught:
        call()
    assert "\n" not in str(caught.value)


def with_action(row: int, *action: Any) -> Any:
    """Return zero actions of a vector env with one action replaced."""
    actions = ZEROS.copy()
    actions[row] = action
    return actions


NAN, INF = np.nan, np.inf


BAD_ACTIONS: Table = {
    "nan": ((NAN, 0, 0, 0), ValueError, "action must be .*nan"),
    "infinite": ((0, 0, INF, 0), ValueError, "action must be .*inf"),
    "minus infinite": ((0, 0, 0, -INF), ValueError, "action must be .* -inf"),
    "too large": ((0, 1.001, 0, 0), ValueError, r"action .* \[-1, 1\], not .*1.00"),
    "too small": ((-1.001, 0, 0, 0), ValueError, r"action .* \[-1, 1\], not .*-1.00"),
    "overflowing": ((1e300, 0, 0, 0), ValueError, "action must be four numbers"),
    "short": ((0, 0, 0), ValueError, r"action must have shape \(4,\), not \(3,\)"),
    "scalar": (0.0, ValueError, r"action must have shape \(4,\), not \(\)"),
    "nested": (((0, 0, 0, 0),), ValueError, r"action must have shape \(4,\), not \(1, 4\)"),
    "text": ("hover", TypeError, "action must contain only numbers, not 'hover'"),
    "numerals": (("1", "0", "0", "0"), TypeError, "action must contain only numbers"),
    "nothing": (None, TypeError, "action must contain only numbers, not None"),
    "list of nothing": ((None,) * 4, TypeError, "action must contain only numbers"),
    "complex": (np.zeros(4, complex), TypeError, "action must contain only numbers"),
    "ragged": (((0, 0), (0,)), TypeError, "action must contain only numbers"),
    "mapping": ({"thrust": 1.0}, TypeError, "action must contain only numbers"),
}


def cases(table: Table) -> pytest.MarkDecorator:
    """Return a table of bad input as parameters of a test."""
    return pytest.mark.parametrize(("value", "kind", "names"), table.values(), ids=table.keys())


def assert_refused_unchanged(env: Any, call: Callable[[], Any], names: str, kind: Any = ERRORS) -> None:
    """Assert that `call` is refused and that `env` then behaves as a copy made before the call."""
    before = copy.deepcopy(env)
    assert_refused(call, names, kind)
    assert_array_equal(env.world.state, before.world.state)
    assert_array_equal(env.world.clock, before.world.clock)
    assert_array_equal(env.world.episode, before.world.episode)
    actions = draw_actions(2, 10, *env.action_space.shape[:-1])
    for _ in range(2):
        assert_same(run_actions(env, actions), run_actions(before, actions))
        assert_same(env.reset(), before.reset())
    assert_same(env.np_random.random(), before.np_random.random())
