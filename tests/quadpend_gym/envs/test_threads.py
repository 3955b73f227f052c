"""Several threads return the numbers of one thread."""

from typing import Any

import numpy as np
import pytest

from tests.helpers.envs import make_vec

RIGID = {"vehicle": "hummingbird", "interface": "body_rates", "latency": 0.02}


def vector(num_threads: int, **parts: Any) -> Any:
    return make_vec(200, num_threads=num_threads, max_episode_steps=5, **parts)


@pytest.mark.parametrize("parts", [{}, {"wind": "windy", "sensors": {"kind": "noise", "position": 0.002}}, RIGID])
@pytest.mark.parametrize("num_threads", [2, 3, 9])
def test_threads_change_no_number(parts: dict[str, Any], num_threads: int) -> None:
    one, many = vector(1, **parts), vector(num_threads, **parts)
    random = np.random.default_rng(0)
    assert np.array_equal(one.reset(seed=3)[0], many.reset(seed=3)[0])
    for _ in range(8):
        action = random.uniform(-0.3, 0.3, (200, 4)).astype(np.float32)
        for expected, found in zip(one.step(action)[:4], many.step(action)[:4], strict=True):
            assert np.array_equal(expected, found)


def test_the_number_of_threads_is_at_least_one() -> None:
    with pytest.raises(ValueError, match="num_threads"):
        vector(0)
