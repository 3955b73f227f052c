"""`ConcatenatedVectorEnv` gives exactly what its environments give one by one."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import VectorEnv
from numpy.testing import assert_array_equal

from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, make_vec
from tests.helpers.wrappers import (
    ACTUATORS,
    OUTPUTS,
    PARAMETERS,
    SENSORS,
    SHORT,
    WIND,
    Layers,
    biased_actions,
    make_wrapped_vec,
)

PARTS: list[tuple[int, Layers, dict[str, Any]]] = [
    (3, [WIND], SHORT),
    (1, [PARAMETERS, ACTUATORS, SENSORS], SHORT),
    (4, [], {**SHORT, "task": "hover"}),
]
ROWS, EDGES = 8, (0, 3, 4, 8)
SLICES = [slice(*edge) for edge in pairwise(EDGES)]
INFOS = ("tracking_error", "tilt", "cause", "reward_terms")


def parts() -> list[VectorEnv[Any, Any, Any]]:
    """Environments whose episodes end at different times."""
    return [make_wrapped_vec(rows, layers, autoreset_mode="SameStep", **more) for rows, layers, more in PARTS]


def joined(values: list[Any]) -> Any:
    """Arrays, or mappings of arrays, of the parts after one another."""
    if isinstance(values[0], dict):
        return {name: joined([value[name] for value in values]) for name in values[0] if name[0] != "_"}
    return np.concatenate(values)


@pytest.mark.parametrize("seed", [11, [40, 41, 42, 7, 0, 1, 2, 3]], ids=["one", "many"])
def test_rows_equal_the_rows_of_the_parts(seed: Any) -> None:
    """Bit for bit, with `final_obs` and `final_info`, over the ends of several episodes."""
    concatenated, others = ConcatenatedVectorEnv(parts()), parts()
    seeds = [seed + row for row in range(ROWS)] if isinstance(seed, int) else seed
    observation, info = concatenated.reset(seed=seed)
    started = [env.reset(seed=seeds[rows]) for env, rows in zip(others, SLICES, strict=True)]
    assert_array_equal(observation, joined([first for first, _ in started]))
    assert_same(info, {name: joined([part[name] for _, part in started]) for name in INFOS})
    ended, partly = np.zeros((2, ROWS), np.int64), 0
    for actions in biased_actions(60, ROWS):
        *returned, info = concatenated.step(actions)
        results = [env.step(actions[rows]) for env, rows in zip(others, SLICES, strict=True)]
        assert_same(returned, [joined([step[item] for step in results]) for item in range(4)])
        assert_same(
            {name: info[name] for name in INFOS}, {name: joined([r[4][name] for r in results]) for name in INFOS}
        )
        over = returned[2] | returned[3]
        ended += np.array(returned[2:])
        assert ("final_obs" in info) == over.any()
        for rows, (*_, expected) in zip(SLICES, results, strict=True):
            partly += over.any() and not over[rows].any()
            for row in np.flatnonzero(over[rows]):
                assert_array_equal(info["final_obs"][rows][row], expected["final_obs"][row])
                for name in ("tracking_error", "tilt"):
                    assert_array_equal(info["final_info"][name][rows][row], expected["final_info"][name][row])
    assert ended.sum(axis=1).min() > 0
    assert ended.sum(axis=0).min() >= 2
    assert partly > 0  # episodes ended in some parts and not in others


@pytest.mark.parametrize(
    ("other", "names"),
    [
        (lambda: make_wrapped_vec(2, [OUTPUTS]), "must have the same observation space"),
        (lambda: make_vec(2, period=0.02), "must have the same interface and control period"),
    ],
    ids=["observations", "simulations"],
)
def test_environments_that_do_not_fit_together_are_refused(other: Any, names: str) -> None:
    assert_refused(lambda: ConcatenatedVectorEnv([make_vec(2), other()]), names, ValueError)
