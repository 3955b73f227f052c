"""The check that wrong input is refused with one sentence."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import pytest

ERRORS = (TypeError, ValueError, gym.error.Error)


def assert_refused(call: Callable[[], Any], names: str, kind: Any = ERRORS) -> None:
    """Assert that `call` raises an error of type `kind` whose message is one line and matches `names`."""
    with pytest.raises(kind, match=names) as caught:
        call()
    assert "\n" not in str(caught.value)
