"""Run a step kernel on several cores: each thread advances a part of the sub-environments.

The kernels release Python's lock, and a sub-environment's numbers do not depend on the others, so the results are the
same for any number of threads.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

from quadpend_gym.envs.inputs import NO_ERROR
from quadpend_gym.physics.plant_kernel import BLOCK


@cache
def _pool(num_threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(num_threads)


os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has the pool, but not its threads


def run_in_threads(num_threads: int, step: Callable[..., int], *arguments: Any) -> int:
    """Call a step kernel in threads; the last two arguments, `begin` and `end`, are divided into parts.

    Returns:
        The error code of the first part with an error.
    """
    *shared, begin, end = arguments
    size = -(-(end - begin) // (BLOCK * num_threads)) * BLOCK
    parts = [(first, min(first + size, end)) for first in range(begin, end, size)]
    others = [_pool(num_threads).submit(step, *shared, *part) for part in parts[1:]]
    errors = [step(*shared, *parts[0]), *(other.result() for other in others)]
    return next((error for error in errors if error != NO_ERROR), NO_ERROR)
