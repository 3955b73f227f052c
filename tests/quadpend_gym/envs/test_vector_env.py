"""The vector environment: equal to single environments to the last bit, in every autoreset mode."""

from dataclasses import replace
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from numpy.testing import assert_array_equal

from quadpend_gym import Limits, Task, Waypoints
from quadpend_gym.core.arrays import Booleans, Floats32
from tests.helpers.envs import (
    AUTORESET_MODES,
    WINDY,
    assert_same,
    draw_actions,
    make,
    make_vec,
    rewards,
    run_actions,
)

SEED, STEPS, MAX_ROWS = 100, 45, 130  # two blocks of 64 and two rows more
# Limits with which some episodes terminate, others are truncated, and every sub-environment has several episodes.
SHORT: dict[str, Any] = {"task": Task(limits=Limits(body_angle=0.5)), "max_episode_steps": 20}
TRAJECTORY = Waypoints((0, 0.15, 0.4), ((0, 0, 2), (0.0002, 0, 2, 0.05), (0.001, 0.001, 2.01)))
CASES: dict[str, dict[str, Any]] = {
    "calm": SHORT,
    "windy": {**SHORT, "wind": WINDY},
    "waypoints": {**SHORT, "task": replace(SHORT["task"], trajectory=TRAJECTORY)},
}

modes = pytest.mark.parametrize("mode", AUTORESET_MODES)
cases = pytest.mark.parametrize("case", CASES)


def biased_actions(rows: int) -> Floats32:
    """Return actions with a different bias for each sub-environment, shape (STEPS, rows, 4).

    Those of one sub-environment do not depend on the number of sub-environments.
    """
    noise = draw_actions(0, MAX_ROWS, STEPS).swapaxes(0, 1)
    return np.ascontiguousarray((0.3 * noise + 0.7 * draw_actions(1, MAX_ROWS))[:, :rows])


@cache
def single_steps(row: int, case: str) -> list[Any]:
    """Return what the single environment with the seed and actions of one sub-environment returns in its episodes.

    The first entry is the first observation. Each further one holds observation, reward, terminated and truncated of a
    step, and the first observation of the next episode if one ended.
    """
    env = make(**CASES[case])
    steps: list[Any] = [env.reset(seed=SEED + row)[0]]
    for action in biased_actions(MAX_ROWS)[:, row]:
        *step, _ = env.step(action)
        steps.append((step, env.reset()[0] if step[2] or step[3] else None))
    return steps


@cases
@pytest.mark.parametrize("rows", [1, 64, MAX_ROWS])
def test_every_sub_environment_equals_the_single_environment(rows: int, case: str) -> None:
    env = make_vec(rows, autoreset_mode="SameStep", **CASES[case])
    first, *later = zip(*(single_steps(row, case) for row in range(rows)), strict=True)
    assert_array_equal(env.reset(seed=SEED)[0], first)
    for actions, expected in zip(biased_actions(rows), later, strict=True):
        observation, *rest, info = env.step(actions)
        for row, (step, start) in enumerate(expected):
            last = info["final_obs"][row] if start is not None else observation[row]
            assert_same([last, *(part[row] for part in rest)], step)
            if start is not None:
                assert_array_equal(observation[row], start)


def test_the_episodes_above_end_by_termination_and_by_truncation() -> None:
    flags = [tuple(step[2:4]) for row in range(MAX_ROWS) for step, _ in single_steps(row, "windy")[1:]]
    assert min(flags.count((True, False)), flags.count((False, True))) > 50


def assert_same_info(ours: dict[str, Any], theirs: dict[str, Any], mask: Booleans) -> None:
    """Assert the same keys, masks and types, and the same values where the masks are true."""
    assert ours.keys() == theirs.keys()
    for key in ours:
        if isinstance(ours[key], dict):
            assert_same_info(ours[key], theirs[key], ours[f"_{key}"])
        elif key.startswith("_"):
            assert_array_equal(ours[key], theirs[key])
        else:
            assert ours[key].dtype == theirs[key].dtype
            assert_same(ours[key][ours[f"_{key}"]], theirs[key][theirs[f"_{key}"]])


@cases
@modes
def test_the_vector_env_equals_gymnasiums_sync_vector_env(mode: str, case: str) -> None:
    env = make_vec(3, autoreset_mode=mode, **CASES[case])
    theirs = gym.make_vec(
        "QuadPendulum-v0",
        num_envs=3,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode(mode)},
        **CASES[case],
    )
    assert env.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    assert env.observation_space == theirs.observation_space
    assert env.action_space == theirs.action_space
    (observation, info), (their_observation, their_info) = env.reset(seed=SEED), theirs.reset(seed=SEED)
    assert_same(observation, their_observation)
    assert_same_info(info, their_info, np.ones(3, np.bool_))
    for actions in biased_actions(3):
        observation, reward, terminated, truncated, info = env.step(actions)
        *their_return, their_info = theirs.step(actions)
        assert_same((observation, reward, terminated, truncated), their_return)
        assert_same_info(info, their_info, np.ones(3, np.bool_))
        over = terminated | truncated
        if mode == "Disabled" and over.any():
            observation, info = env.reset(options={"reset_mask": over})
            their_observation, their_info = theirs.reset(options={"reset_mask": over})
            assert_same(observation, their_observation)
            assert_same_info(info, their_info, over)


def test_reset_mask_resets_only_the_masked_sub_environments() -> None:
    env, untouched = make_vec(4, wind=WINDY), make_vec(4, wind=WINDY)
    mask = np.array([True, False, False, True])
    env.reset(seed=0), untouched.reset(seed=0)
    run_actions(env, draw_actions(0, 5, 4)), run_actions(untouched, draw_actions(0, 5, 4))
    before = env.state.array.copy()
    _, info = env.reset(seed=70, options={"reset_mask": mask, "state": {"position": (0.0, 0.0, 3.0)}})
    assert_array_equal(env.state.array[~mask], before[~mask])
    assert_array_equal(env.state.position[mask], np.broadcast_to((0.0, 0.0, 3.0), (2, 3)))
    assert_array_equal(info["_tilt"], mask)
    assert env.world.episode.tolist() == [0, 0, 0, 0]
    actions = draw_actions(1, 10, 4)
    assert_array_equal(
        [step[0][~mask] for step in run_actions(env, actions)],
        [step[0][~mask] for step in run_actions(untouched, actions)],
    )
    assert_array_equal(env.reset()[0][mask], make_twice_reset(70)[mask])


def make_twice_reset(seed: int) -> Floats32:
    """Return the first observations of the second episodes of four sub-environments."""
    env = make_vec(4, wind=WINDY)
    env.reset(seed=seed)
    return env.reset()[0]


@pytest.mark.parametrize("seeds", [[5, 2, 5], (5, 2, 5), np.array([5, 2, 5])], ids=["list", "tuple", "array"])
def test_each_sub_environment_can_have_its_own_seed(seeds: Any) -> None:
    observation, _ = make_vec(3).reset(seed=seeds)
    assert_array_equal(observation, [make().reset(seed=seed)[0] for seed in (5, 2, 5)])


def test_a_sub_environment_without_a_seed_starts_its_next_episode() -> None:
    env, single = make_vec(3), make()
    env.reset(seed=10)
    single.reset(seed=12)
    observation, _ = env.reset(seed=[None, 11, None])
    assert_array_equal(observation[1], make().reset(seed=11)[0])
    assert_array_equal(observation[2], single.reset()[0])


def test_an_episode_depends_only_on_its_seed_and_number() -> None:
    """Neither earlier actions, nor the length of earlier episodes, nor other sub-environments change it."""
    env = make_vec(5, wind=WINDY, autoreset_mode="SameStep", **SHORT)
    single = make(wind=WINDY)
    env.reset(seed=0)
    single.reset(seed=3)
    starts = [single.reset()[0] for _ in range(4)]
    observed = []
    for actions in np.concatenate([biased_actions(5)] * 3):
        observation, _, terminated, truncated, _ = env.step(actions)
        if terminated[3] or truncated[3]:
            observed.append(observation[3])
    assert_same(observed[:4], starts)
    # Both have had the same number of episodes, so the wind is the same from here on.
    single.reset(seed=3, options={"state": {"position": (0.0, 0.0, 5.0)}})
    env.reset(seed=0), env.reset(), single.reset()
    action = draw_actions(9, 1, 5)[0]
    assert_array_equal(
        [step[0][3] for step in run_actions(env, [action] * 5)], [s[0] for s in run_actions(single, [action[3]] * 5)]
    )


def test_wind_leaves_starts_and_references_unchanged() -> None:
    calm, windy = make_vec(10), make_vec(10, wind=WINDY)
    for seed in (0, None, None):
        assert_same(windy.reset(seed=seed), calm.reset(seed=seed))
        assert_array_equal(windy.world.reference, calm.world.reference)
        pushed, still = (run_actions(env, np.zeros((3, 10, 4)))[-1][0] for env in (windy, calm))
        assert (pushed != still).any(axis=-1).all()


@pytest.mark.parametrize("mode", AUTORESET_MODES[:2])
def test_gymnasiums_record_episode_statistics_agrees(mode: str) -> None:
    env = RecordEpisodeStatistics(make_vec(3, autoreset_mode=mode, **SHORT))
    env.reset(seed=SEED)
    steps = run_actions(env, biased_actions(3))
    over = np.array([terminated | truncated for _, _, terminated, truncated, _ in steps])
    for row in range(3):
        ends = np.flatnonzero(over[:, row])
        begin = 0
        for end in ends:
            episode = steps[end][4]["episode"]
            np.testing.assert_allclose(episode["r"][row], rewards(steps)[begin : end + 1, row].sum(), rtol=1e-12)
            assert episode["l"][row] == end + 1 - begin
            begin = int(end) + (2 if mode == "NextStep" else 1)
    assert env.episode_count == over.sum()
