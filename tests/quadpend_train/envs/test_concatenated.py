"""A mixture of environments is its parts, row by row, and nothing else."""

from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.policy.rollout import RolloutStep, rollout
from quadpend_gym import Simulation
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import assert_same, draw_actions, make, make_vec, run_actions
from tests.helpers.policies import ZeroThrust
from tests.helpers.wrappers import (
    ACTUATORS,
    HISTORY,
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


def assert_same_row(info: dict[str, Any], row: int, theirs: dict[str, Any], their_row: int) -> None:
    """What a mixture's info says of a row is what that of the part says."""
    assert_array_equal(info["tracking_error"][row], theirs["tracking_error"][their_row])
    assert info["tilt"][row] == theirs["tilt"][their_row]
    for name, value in info["reward_terms"].items():
        assert value[row] == theirs["reward_terms"][name][their_row]


@pytest.mark.parametrize("seed", [11, [40, 41, 42, 7, 0, 1, 2, 3]], ids=["one", "many"])
def test_its_rows_are_those_of_its_parts(seed: Any) -> None:
    """To the bit, `final_obs` and `final_info` too, through the ends of several episodes."""
    mixture, others = ConcatenatedVectorEnv(parts()), parts()
    seeds = [seed + row for row in range(ROWS)] if isinstance(seed, int) else seed
    observation, info = mixture.reset(seed=seed)
    begun = [env.reset(seed=seeds[rows]) for env, rows in zip(others, SLICES, strict=True)]
    assert mixture.observation_space.contains(observation)
    assert_array_equal(observation, np.concatenate([first for first, _ in begun]))
    for rows, (_, theirs) in zip(SLICES, begun, strict=True):
        for row in range(rows.start, rows.stop):
            assert_same_row(info, row, theirs, row - rows.start)
    ended = np.zeros((2, ROWS), np.int64)
    alone = 0
    for actions in biased_actions(60, ROWS):
        *returned, info = mixture.step(actions)
        stepped = [env.step(actions[rows]) for env, rows in zip(others, SLICES, strict=True)]
        for part in range(4):
            assert_array_equal(returned[part], np.concatenate([step[part] for step in stepped]))
        over = returned[2] | returned[3]
        ended += np.array(returned[2:])
        assert ("final_obs" in info) == over.any()
        if over.any():
            assert_array_equal(info["_final_obs"], over)
            assert_array_equal(info["_final_info"], over)
            alone += sum(not over[rows].any() for rows in SLICES)
        for rows, (*_, theirs) in zip(SLICES, stepped, strict=True):
            for row in range(rows.start, rows.stop):
                assert_same_row(info, row, theirs, row - rows.start)
                if over[row]:
                    assert_array_equal(info["final_obs"][row], theirs["final_obs"][row - rows.start])
                    assert_same_row(info["final_info"], row, theirs["final_info"], row - rows.start)
                elif over.any():
                    assert info["final_obs"][row] is None
    assert ended[0].sum() > 0
    assert ended[1].sum() > 0
    assert ended.sum(axis=0).min() >= 2
    assert alone > 0  # episodes of some parts ended, and of others none


def test_unseeded_episodes_go_on_as_those_of_the_parts() -> None:
    mixture, others = ConcatenatedVectorEnv(parts()), parts()
    mixture.reset(seed=5)
    for env, rows in zip(others, SLICES, strict=True):
        env.reset(seed=5 + rows.start)
    for _ in range(2):
        actions = draw_actions(0, 5, ROWS)
        run_actions(mixture, actions)
        for env, rows in zip(others, SLICES, strict=True):
            run_actions(env, actions[:, rows])
        again = np.concatenate([env.reset()[0] for env in others])
        assert_array_equal(mixture.reset()[0], again)


def test_a_mixture_of_one_is_that_one() -> None:
    mixture, env = (
        ConcatenatedVectorEnv([make_vec(3, autoreset_mode="SameStep", **SHORT)]),
        make_vec(3, autoreset_mode="SameStep", **SHORT),
    )
    assert_same(mixture.reset(seed=0)[0], env.reset(seed=0)[0])
    actions = biased_actions(40, 3)
    assert_same([step[:4] for step in run_actions(mixture, actions)], [step[:4] for step in run_actions(env, actions)])


def test_a_row_of_it_does_not_depend_on_the_other_parts() -> None:
    one, other = ConcatenatedVectorEnv(parts()[:2]), ConcatenatedVectorEnv([parts()[0], parts()[2]])
    assert_array_equal(one.reset(seed=0)[0][:3], other.reset(seed=0)[0][:3])
    actions = biased_actions(30, 7)
    for a, b in zip(run_actions(one, actions[:, :4]), run_actions(other, actions), strict=True):
        for part in range(4):
            assert_array_equal(a[part][:3], b[part][:3])


def test_options_reach_every_part() -> None:
    mixture = ConcatenatedVectorEnv(parts())
    mixture.reset(seed=0, options={"state": {"position": [0.0, 0.0, 2.5]}})
    for env in mixture.envs:
        assert_array_equal(env.unwrapped.state.position, [[0.0, 0.0, 2.5]] * env.num_envs)  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="wrong"):
        mixture.reset(options={"wrong": 1})


@pytest.mark.parametrize("name", ["adrc-matched", "flatness"])
def test_a_rollout_in_it_is_that_in_its_parts(name: str) -> None:
    mixed = list(rollout(controller(name), ConcatenatedVectorEnv(parts()), 20))
    flown = [list(rollout(controller(name), env, 20 + rows.start)) for env, rows in zip(parts(), SLICES, strict=True)]
    assert len(mixed) == max(map(len, flown))
    for rows, flight in zip(SLICES, flown, strict=True):
        for number, step in enumerate(mixed):
            if number >= len(flight):
                assert not step.active[rows].any()
                continue
            theirs, flying = flight[number], flight[number].active
            assert_array_equal(step.active[rows], flying)
            for field in RolloutStep._fields[1:]:
                if field != "memory":
                    assert_array_equal(getattr(step, field)[rows][flying], getattr(theirs, field)[flying])


def test_the_info_at_the_end_of_an_episode_is_of_its_last_step() -> None:
    """And not of the next one's first: who falls is far away."""
    steps = list(
        rollout(ZeroThrust(), ConcatenatedVectorEnv([make_vec(2, autoreset_mode="SameStep") for _ in range(2)]), 0)
    )
    last = [step for step in steps if step.terminated.any()]
    assert all(
        step.tracking_error[row, 2] < -1.0 for step in last for row in np.flatnonzero(step.terminated & step.active)
    )


def test_stable_baselines_takes_it() -> None:
    env = SB3VecEnv(ConcatenatedVectorEnv(parts()), 0.01)
    plain = [SB3VecEnv(part, 0.01) for part in parts()]
    env.seed(3)
    for part, rows in zip(plain, SLICES, strict=True):
        part.seed(3 + rows.start)
    assert_array_equal(env.reset(), np.concatenate([part.reset() for part in plain]))
    for actions in biased_actions(40, ROWS):
        observation, reward, over, infos = env.step(actions)
        stepped = [part.step(actions[rows]) for part, rows in zip(plain, SLICES, strict=True)]
        assert_array_equal(observation, np.concatenate([step[0] for step in stepped]))
        assert_array_equal(reward, np.concatenate([step[1] for step in stepped]))
        assert_array_equal(over, np.concatenate([step[2] for step in stepped]))
        for mine, theirs in zip(infos, [info for step in stepped for info in step[3]], strict=True):
            assert mine.keys() == theirs.keys()
            if mine:
                assert_array_equal(mine["terminal_observation"], theirs["terminal_observation"])
                assert mine["TimeLimit.truncated"] == theirs["TimeLimit.truncated"]
                assert mine["episode"]["r"] == theirs["episode"]["r"]
    means, shares = env.take_means(), [part.take_means() for part in plain]
    for name, value in means.items():
        counts = [part.num_envs for part in plain]
        assert value == pytest.approx(np.average([share[name] for share in shares], weights=counts))


def test_it_closes_its_parts() -> None:
    mixture = ConcatenatedVectorEnv(parts())
    mixture.close()
    assert all(env.unwrapped.closed for env in mixture.envs)


def rows_of(**kwargs: Any) -> VectorEnv[Any, Any, Any]:
    return make_vec(2, **{"autoreset_mode": "SameStep", **kwargs})


BAD: dict[str, tuple[Any, str]] = {
    "none": (list, "needs an environment"),
    "next-step autoreset": (lambda: [rows_of(), make_vec(2)], "must have autoreset_mode SAME_STEP, not .*NEXT_STEP"),
    "no autoreset": (lambda: [rows_of(autoreset_mode="Disabled")], "SAME_STEP, not .*DISABLED"),
    "other observations": (
        lambda: [rows_of(), make_wrapped_vec(2, [OUTPUTS], autoreset_mode="SameStep")],
        r"same observations, not .*36.* and .*27",
    ),
    "a history": (
        lambda: [make_wrapped_vec(2, [HISTORY], autoreset_mode="SameStep"), rows_of()],
        r"same observations, not .*116.* and .*36",
    ),
    "other simulations": (
        lambda: [rows_of(), rows_of(simulation=Simulation(period=0.02))],
        "must have the same nominal simulation",
    ),
    "another environment": (
        lambda: [
            gym.make_vec(
                "CartPole-v1", 2, vectorization_mode="sync", vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP}
            )
        ],
        "QuadPendulum",
    ),
    "single environments side by side": (
        lambda: [SyncVectorEnv([make] * 2, autoreset_mode=AutoresetMode.SAME_STEP)],
        "QuadPendulum",
    ),
    "a mixture": (lambda: [ConcatenatedVectorEnv([rows_of()])], "QuadPendulum|mixture"),
}


@pytest.mark.parametrize(("envs", "names"), BAD.values(), ids=BAD.keys())
def test_what_does_not_mix_is_refused(envs: Any, names: str) -> None:
    assert_refused(lambda: ConcatenatedVectorEnv(envs()), names, (ValueError, TypeError))


@pytest.mark.parametrize("actions", [np.zeros((7, 4)), np.zeros((9, 4)), np.zeros(4), np.full((8, 4), 2.0)])
def test_impossible_actions_are_refused(actions: Any) -> None:
    mixture = ConcatenatedVectorEnv(parts())
    mixture.reset(seed=0)
    assert_refused(lambda: mixture.step(actions), "action", (ValueError, TypeError))


def test_an_action_that_is_refused_leaves_no_trace() -> None:
    """Not in the parts before the one that refuses it, either."""
    mixture, twin = ConcatenatedVectorEnv(parts()), ConcatenatedVectorEnv(parts())
    mixture.reset(seed=0), twin.reset(seed=0)
    bad = np.zeros((ROWS, 4), np.float32)
    bad[-1, 2] = np.nan
    assert_refused(lambda: mixture.step(bad), "action", ValueError)
    actions = draw_actions(0, 3, ROWS)
    assert_same([step[:4] for step in run_actions(mixture, actions)], [step[:4] for step in run_actions(twin, actions)])


@pytest.mark.parametrize("seed", [[1, 2], list(range(9)), -1, 1.5])
def test_impossible_seeds_are_refused(seed: Any) -> None:
    assert_refused(lambda: ConcatenatedVectorEnv(parts()).reset(seed=seed), "seed", (ValueError, TypeError))
