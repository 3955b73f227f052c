"""The check that wrong input is refused with one sentence, and that it changes nothing."""

import copy
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers.envs import assert_same, draw_actions, run_actions

ERRORS = (TypeError, ValueError, gym.error.Error)
NAN, INF = np.nan, np.inf
BAD_ACTIONS: dict[str, tuple[Any, Any, str]] = {
    "nan": ((NAN, 0, 0, 0), ValueError, "action must be .*nan"),
    "too large": ((0, 1.001, 0, 0), ValueError, r"action .* \[-1, 1\], not .*1.00"),
    "short": ((0, 0, 0), ValueError, r"action must be numbers of shape \(4,\), not \(0, 0, 0\)"),
    "text": ("hover", ValueError, "action must be numbers of shape .* not 'hover'"),
}


def cases(table: dict[str, Any]) -> pytest.MarkDecorator:
    """Return a table of bad values, with type and pattern of the error, as parameters of a test."""
    return pytest.mark.parametrize(("value", "kind", "names"), table.values(), ids=table.keys())


def assert_refused(call: Callable[[], Any], names: str, kind: Any = ERRORS) -> None:
    """Assert that `call` raises an error of type `kind` whose message is one line and matches `names`."""
    with pytest.raises(kind, match=names) as caught:
        call()
    assert "\n" not in str(caught.value)


def assert_refused_unchanged(env: Any, call: Callable[[], Any], names: str, kind: Any = ERRORS) -> None:
    """Assert that `call` is refused and that `env` then behaves as a copy made before the call."""
    before = copy.deepcopy(env)
    assert_refused(call, names, kind)
    assert_array_equal(env.world.state, before.world.state)
    actions = draw_actions(2, 10, *env.action_space.shape[:-1])
    for _ in range(2):
        assert_same(run_actions(env, actions), run_actions(before, actions))
        assert_same(env.reset(), before.reset())
