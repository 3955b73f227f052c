"""`ConcatenatedVectorEnv` gives exactly what its environments give one by one."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import VectorEnv
from numpy.testing import assert_array_equal

from quadpend_train.envs.concatenated import ConcatenatedVectorEnv, worlds
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, draw_actions, make_vec, run_actions
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


def parts() -> list[VectorEnv[Any, Any, Any]]:
    """Environments whose episodes end at different times."""
    return [make_wrapped_vec(rows, layers, autoreset_mode="SameStep", **more) for rows, layers, more in PARTS]


def assert_same_row(info: dict[str, Any], row: int, part_info: dict[str, Any], part_row: int) -> None:
    """The info of a row equals the info of the corresponding row of the part."""
    assert_array_equal(info["tracking_error"][row], part_info["tracking_error"][part_row])
    assert info["tilt"][row] == part_info["tilt"][part_row]
    for name, value in info["reward_terms"].items():
        assert value[row] == part_info["reward_terms"][name][part_row]


@pytest.mark.parametrize("seed", [11, [40, 41, 42, 7, 0, 1, 2, 3]], ids=["one", "many"])
def test_rows_equal_the_rows_of_the_parts(seed: Any) -> None:
    """Bit for bit, with `final_obs` and `final_info`, over the ends of several episodes."""
    concatenated, others = ConcatenatedVectorEnv(parts()), parts()
    seeds = [seed + row for row in range(ROWS)] if isinstance(seed, int) else seed
    observation, info = concatenated.reset(seed=seed)
    started = [env.reset(seed=seeds[rows]) for env, rows in zip(others, SLICES, strict=True)]
    assert concatenated.observation_space.contains(observation)
    assert_array_equal(observation, np.concatenate([first for first, _ in started]))
    for rows, (_, expected) in zip(SLICES, started, strict=True):
        for row in range(rows.start, rows.stop):
            assert_same_row(info, row, expected, row - rows.start)
    ended = np.zeros((2, ROWS), np.int64)
    partly = 0
    for actions in biased_actions(60, ROWS):
        *returned, info = concatenated.step(actions)
        results = [env.step(actions[rows]) for env, rows in zip(others, SLICES, strict=True)]
        for part in range(4):
            assert_array_equal(returned[part], np.concatenate([step[part] for step in results]))
        over = returned[2] | returned[3]
        ended += np.array(returned[2:])
        assert ("final_obs" in info) == over.any()
        if over.any():
            assert_array_equal(info["_final_obs"], over)
            assert_array_equal(info["_final_info"], over)
            partly += sum(not over[rows].any() for rows in SLICES)
        for rows, (*_, expected) in zip(SLICES, results, strict=True):
            for row in range(rows.start, rows.stop):
                assert_same_row(info, row, expected, row - rows.start)
                if over[row]:
                    assert_array_equal(info["final_obs"][row], expected["final_obs"][row - rows.start])
                    assert_same_row(info["final_info"], row, expected["final_info"], row - rows.start)
                elif over.any():
                    assert info["final_obs"][row] is None
    assert ended[0].sum() > 0
    assert ended[1].sum() > 0
    assert ended.sum(axis=0).min() >= 2
    assert partly > 0  # episodes ended in some parts and not in others


def test_reset_options_reach_every_part() -> None:
    concatenated = ConcatenatedVectorEnv(parts())
    concatenated.reset(seed=0, options={"state": {"position": [0.0, 0.0, 2.5]}})
    for env in concatenated.envs:
        assert_array_equal(env.unwrapped.state.position, [[0.0, 0.0, 2.5]] * env.num_envs)  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="wrong"):
        concatenated.reset(options={"wrong": 1})


def make_two(**kwargs: Any) -> VectorEnv[Any, Any, Any]:
    return make_vec(2, **{"autoreset_mode": "SameStep", **kwargs})


@pytest.mark.parametrize(
    ("envs", "names"),
    [
        (lambda: [make_two(), make_vec(2)], "must have autoreset_mode .*SAME_STEP, not .*NEXT_STEP"),
        (
            lambda: [make_two(), make_wrapped_vec(2, [OUTPUTS], autoreset_mode="SameStep")],
            r"same observation space, not .*36.* and .*27",
        ),
        (lambda: [make_two(), make_two(period=0.02)], "must have the same nominal simulation"),
    ],
    ids=["autoreset", "observations", "simulations"],
)
def test_environments_that_do_not_fit_together_are_refused(envs: Any, names: str) -> None:
    assert_refused(lambda: ConcatenatedVectorEnv(envs()), names, ValueError)


def test_a_concatenation_of_concatenations_gives_the_same_as_one_of_all_parts() -> None:
    first, *rest = parts()
    flat, nested = ConcatenatedVectorEnv(parts()), ConcatenatedVectorEnv([first, ConcatenatedVectorEnv(rest)])
    assert_same(flat.reset(seed=0), nested.reset(seed=0))
    for actions in biased_actions(40, ROWS):
        *returned, info = flat.step(actions)
        *others, other = nested.step(actions)
        assert_same(returned, others)
        assert_same(info.get("final_obs"), other.get("final_obs"))
    assert [world.num_envs for world in worlds(nested)] == [world.num_envs for world in worlds(flat)]


def test_refused_action_changes_nothing() -> None:
    """Not even in the parts before the one whose action is invalid."""
    concatenated, other = ConcatenatedVectorEnv(parts()), ConcatenatedVectorEnv(parts())
    concatenated.reset(seed=0), other.reset(seed=0)
    bad = np.zeros((ROWS, 4), np.float32)
    bad[-1, 2] = np.nan
    assert_refused(lambda: concatenated.step(bad), "action", ValueError)
    actions = draw_actions(0, 3, ROWS)
    assert_same(
        [step[:4] for step in run_actions(concatenated, actions)], [step[:4] for step in run_actions(other, actions)]
    )
