"""Environments with a companion: one and many are the same, in every autoreset mode, and say what they cannot do."""

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env as check_with_gymnasium
from gymnasium.vector import SyncVectorEnv, VectorEnv
from numpy.testing import assert_allclose, assert_array_equal
from quadpend_baselines.hybrid.companion import Companion
from stable_baselines3.common.env_checker import check_env as check_with_sb3

from quadpend_baselines import controller
from quadpend_baselines.hybrid import wrappers
from quadpend_baselines.hybrid.wrappers import (
    DisturbanceEstimateObservation,
    PaceAction,
    ResidualAction,
    VectorDisturbanceEstimateObservation,
    VectorPaceAction,
    VectorResidualAction,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import AUTORESET_MODES, assert_same, draw_actions, make, make_vec, run_actions
from tests.helpers.hybrid import Steered, constant, flown
from tests.helpers.wrappers import HISTORY, OUTPUTS, SENSORS, SHORT, WIND, Layers, make_wrapped, make_wrapped_vec

Kind = tuple[Any, ...]  # the name of a wrapper, then its arguments
KINDS: dict[str, Kind] = {
    "estimate, adrc": ("DisturbanceEstimateObservation", "adrc-matched"),
    "estimate, flatness": ("DisturbanceEstimateObservation", "flatness"),
    "residual, adrc": ("ResidualAction", "adrc-matched", 0.5),
    "residual, flatness": ("ResidualAction", "flatness", 0.3),
    "residual, lqi": ("ResidualAction", "lqi", 0.3),
    "pace": ("PaceAction", "flatness", 1.0),
}
SIZES = {"estimate, adrc": 45, "estimate, flatness": 45, "residual, adrc": 49, "residual, flatness": 49}
INSIDE: dict[str, Layers] = {"plain": [WIND], "sensors and outputs": [WIND, SENSORS, OUTPUTS]}
kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())
BRIEF = {**SHORT, "max_episode_steps": 9}
each = pytest.mark.parametrize("kind", [KINDS["estimate, adrc"], KINDS["residual, flatness"], KINDS["pace"]])
modes = pytest.mark.parametrize("mode", AUTORESET_MODES)
insides = pytest.mark.parametrize("layers", INSIDE.values(), ids=INSIDE.keys())


def accompanied(env: Any, kind: Kind) -> Any:
    """`env`, an Env or a VectorEnv, in a wrapper with a companion."""
    prefix = "Vector" if isinstance(env, VectorEnv) else ""
    return getattr(wrappers, prefix + kind[0])(env, *kind[1:])


def singles(rows: int, layers: Layers, kind: Kind, mode: str) -> Any:
    """What Gymnasium makes of single environments with companions: the oracle of the wrapped vector environment."""
    return SyncVectorEnv([lambda: accompanied(make_wrapped(layers, **BRIEF), kind)] * rows, autoreset_mode=mode)


def learners(steps: int, rows: int) -> Floats32:
    """Actions of learners who differ, so that rows end at different times, shape (steps, rows, 4)."""
    return np.clip(0.3 * draw_actions(0, steps, rows) + draw_actions(1, rows), -1.0, 1.0)


@modes
@insides
@each
def test_the_rows_are_what_single_environments_are(kind: Kind, layers: Layers, mode: str) -> None:
    """To the bit, through the ends of several episodes; the last observation of one ends the old episode."""
    rows = 3
    env = accompanied(make_wrapped_vec(rows, layers, autoreset_mode=mode, **BRIEF), kind)
    theirs = singles(rows, layers, kind, mode)
    assert env.single_observation_space == theirs.single_observation_space
    assert env.observation_space == theirs.observation_space
    assert env.action_space == theirs.action_space
    assert_array_equal(env.reset(seed=7)[0], theirs.reset(seed=7)[0])
    ended = np.zeros(rows, np.int64)
    for action in learners(30, rows):
        *returned, info = env.step(action)
        *their_return, their_info = theirs.step(action)
        assert_same(returned, their_return)
        assert env.observation_space.contains(returned[0])
        over = returned[2] | returned[3]
        ended += over
        if mode == "SameStep":
            for row in np.flatnonzero(over):
                assert_array_equal(info["final_obs"][row], their_info["final_obs"][row])
                assert env.single_observation_space.contains(info["final_obs"][row])
        if mode == "Disabled" and over.any():
            mask = {"reset_mask": over}
            assert_array_equal(env.reset(options=mask)[0], theirs.reset(options=mask)[0])
    assert ended.min() >= 2


@kinds
def test_the_last_observation_goes_on_with_the_old_episode(kind: Kind) -> None:
    """It is what would have been seen if the episode had not ended; the controller has not forgotten."""
    short = accompanied(make_vec(3, wind="windy", max_episode_steps=15, autoreset_mode="SameStep"), kind)
    long = accompanied(make_vec(3, wind="windy", max_episode_steps=None, autoreset_mode="Disabled"), kind)
    assert_array_equal(short.reset(seed=0)[0], long.reset(seed=0)[0])
    for action in 0.1 * draw_actions(0, 15, 3):
        observation, _, _, truncated, info = short.step(action)
        expected = long.step(action)[0]
    assert truncated.all()
    assert_array_equal(np.stack(info["final_obs"]), expected)
    assert (observation != expected).any(axis=1).all()


@kinds
def test_a_new_episode_begins_as_if_there_had_been_none_before(kind: Kind) -> None:
    envs = [
        accompanied(make_vec(3, wind="windy", max_episode_steps=15, autoreset_mode="SameStep"), kind) for _ in range(2)
    ]
    actions = 0.1 * draw_actions(0, 30, 3)
    flights = []
    for env, first in zip(envs, (actions[:15], -actions[:15]), strict=True):
        env.reset(seed=0)
        run_actions(env, first)
        flights.append([step[0] for step in run_actions(env, actions[15:29])])
    assert_same(*flights)


@each
def test_a_reset_of_some_rows_leaves_the_companions_of_the_others(kind: Kind) -> None:
    env, untouched = (accompanied(make_vec(3, wind="windy"), kind) for _ in range(2))
    env.reset(seed=0), untouched.reset(seed=0)
    actions = 0.2 * draw_actions(0, 6, 3)
    seen = run_actions(env, actions)[-1][0]
    run_actions(untouched, actions)
    mask = np.array([False, True, False])
    begun, _ = env.reset(options={"reset_mask": mask})
    assert_array_equal(begun[~mask], seen[~mask])
    after, beside = run_actions(env, actions)[-1][0], run_actions(untouched, actions)[-1][0]
    assert_array_equal(after[~mask], beside[~mask])
    assert (after[mask] != beside[mask]).any()


@each
def test_of_rows_that_have_ended_those_that_were_reset_go_on_and_the_others_begin(kind: Kind) -> None:
    """As their episodes do, with next-step autoreset."""
    env = accompanied(make_vec(3, wind="windy", max_episode_steps=4), kind)
    twin = accompanied(make_vec(3, wind="windy", max_episode_steps=4, autoreset_mode="Disabled"), kind)
    env.reset(seed=0), twin.reset(seed=0)
    actions = 0.1 * draw_actions(0, 6, 3)
    run_actions(env, actions[:4]), run_actions(twin, actions[:4])
    mask = np.array([True, False, True])
    first = env.reset(options={"reset_mask": mask})[0][mask]
    assert_array_equal(first, twin.reset(options={"reset_mask": mask})[0][mask])
    begun, _ = twin.reset(options={"reset_mask": ~mask})
    seen = env.step(actions[4])[0]
    assert_array_equal(seen[~mask], begun[~mask])
    assert (seen[mask] != begun[mask]).any(axis=1).all()


@kinds
@insides
def test_the_observation_is_what_the_companion_shows(kind: Kind, layers: Layers) -> None:
    """And the plain environment is flown as the companion wants it."""
    steers = {"DisturbanceEstimateObservation": "alone", "ResidualAction": "action", "PaceAction": "pace"}[kind[0]]
    learner = constant(0.02, -0.01, 0.03, 0.1)
    companion = Companion(controller(kind[1]), steers, *kind[2:])
    plain = make_wrapped_vec(3, layers, autoreset_mode="SameStep", **SHORT)
    policy = Steered(companion, learner)
    _, returns = flown(policy, plain, 30)
    env = accompanied(make_wrapped_vec(3, layers, autoreset_mode="SameStep", **SHORT), kind)
    observation, _ = env.reset(seed=5)
    for seen, expected in zip(policy.seen, returns, strict=True):
        assert_array_equal(observation, seen)
        observation, *rest, _ = env.step(learner(observation))
        assert_same(rest, list(expected[1:4]))


@pytest.mark.parametrize("name", KINDS)
def test_the_spaces_have_the_sizes_of_the_table(name: str) -> None:
    for outputs in (False, True):
        inner = make_wrapped([OUTPUTS] if outputs else [])
        expected = SIZES.get(name, 45 if name == "pace" else 49)
        if outputs and "adrc" in name:
            expected -= 9  # it estimates no whole state
        assert accompanied(inner, KINDS[name]).observation_space.shape == (expected,)


@each
def test_the_controller_is_that_of_the_environments_simulation(kind: Kind) -> None:
    heavy = Simulation({"bob_mass": 0.3})  # type: ignore[arg-type]
    for env in (make(simulation=heavy), make_vec(2, simulation=heavy)):
        assert accompanied(env, kind).companion.controller.simulation == heavy


@each
def test_a_controller_may_be_given_instead_of_its_name(kind: Kind) -> None:
    name, of, *rest = kind
    by_name, given = (accompanied(make_vec(2), (name, which, *rest)) for which in (of, controller(of)))
    assert_array_equal(by_name.reset(seed=0)[0], given.reset(seed=0)[0])
    actions = 0.1 * draw_actions(0, 5, 2)
    assert_same(run_actions(by_name, actions), run_actions(given, actions))


@pytest.mark.parametrize("rows", [(), (3,)], ids=["one", "many"])
@each
def test_an_observation_once_given_does_not_change(kind: Kind, rows: tuple[int, ...]) -> None:
    env = accompanied(make_vec(3, autoreset_mode="SameStep", **SHORT) if rows else make(), kind)
    given = [env.reset(seed=0)[0], *(step[0] for step in run_actions(env, 0.1 * draw_actions(0, 3, *rows)))]
    kept = [seen.copy() for seen in given]
    run_actions(env, 0.1 * draw_actions(1, 25 if rows else 5, *rows))
    env.reset()
    assert_same(given, kept)


BAD_ACTIONS = {
    "too large": (np.full(4, 1.5), "must be four numbers"),
    "nan": (np.array([0.0, np.nan, 0.0, 0.0]), "must be four numbers"),
    "infinite": (np.array([np.inf, 0.0, 0.0, 0.0]), "must be four numbers"),
    "three": (np.zeros(3), r"shape .*4"),
    "one": (np.zeros(1), r"shape .*4"),
}


@pytest.mark.parametrize(("action", "names"), BAD_ACTIONS.values(), ids=BAD_ACTIONS.keys())
@pytest.mark.parametrize("rows", [(), (3,)], ids=["one", "many"])
@each
def test_an_action_that_is_refused_leaves_no_trace(kind: Kind, rows: tuple[int, ...], action: Any, names: str) -> None:
    """The learner's actions are from −1 to 1, whatever becomes of them, as in the environment without companion."""
    env, twin = (accompanied(make_vec(3) if rows else make(), kind) for _ in range(2))
    env.reset(seed=0), twin.reset(seed=0)
    bad = np.tile(action, (3, 1)) if rows else action
    assert_refused(lambda: env.step(bad), names, (ValueError, TypeError))
    actions = 0.1 * draw_actions(0, 3, *rows)
    assert_same(run_actions(env, actions), run_actions(twin, actions))


@pytest.mark.parametrize("rows", [False, True], ids=["one", "many"])
@each
def test_a_step_before_the_first_reset_is_refused(kind: Kind, rows: bool) -> None:
    env = accompanied(make_vec(3) if rows else make(), kind)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((3, 4)) if rows else np.zeros(4))


@each
def test_the_checkers_have_nothing_to_remark(kind: Kind) -> None:
    with warnings.catch_warnings(action="error"):
        check_with_sb3(accompanied(make(), kind))
    with warnings.catch_warnings(record=True, action="always") as caught:
        check_with_gymnasium(accompanied(make(), kind), skip_render_check=True)
    (remark,) = caught
    assert "is different from the unwrapped version" in str(remark.message)


@insides
@each
def test_the_spec_survives_json(kind: Kind, layers: Layers) -> None:
    env = accompanied(make_wrapped(layers, max_episode_steps=7), kind)
    assert env.spec is not None
    twin = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert str(twin) == str(env)
    assert_same(twin.reset(seed=3), env.reset(seed=3))
    actions = 0.1 * draw_actions(3, 7)
    assert_same(run_actions(twin, actions), run_actions(env, actions))


def test_the_single_ones_have_the_defaults_of_the_many() -> None:
    for one, many in (
        (DisturbanceEstimateObservation, VectorDisturbanceEstimateObservation),
        (ResidualAction, VectorResidualAction),
        (PaceAction, VectorPaceAction),
    ):
        single, vector = one(make()).companion, many(make_vec(2)).companion  # type: ignore[operator]
        for name in ("steers", "authority"):
            assert getattr(single, name) == getattr(vector, name)
        assert type(single.controller) is type(vector.controller)
        assert_allclose(single.authority, {"action": 0.3}.get(single.steers, 1.0))


BAD: dict[str, tuple[Callable[[Any], Any], str, Any]] = {
    "inside a history": (
        lambda prefix: accompanied(
            make_wrapped_vec(2, [HISTORY]) if prefix else make_wrapped([HISTORY]), KINDS["pace"]
        ),
        "observation of 36 or 27 numbers, not from .*116.*: put its wrapper inside",
        ValueError,
    ),
    "twice": (
        lambda prefix: accompanied(accompanied(make_vec(2) if prefix else make(), KINDS["pace"]), KINDS["pace"]),
        "36 or 27 numbers, not from .*45",
        ValueError,
    ),
    "another environment": (
        lambda prefix: accompanied(
            gym.make_vec("CartPole-v1", 2) if prefix else gym.make("CartPole-v1"), KINDS["pace"]
        ),
        "36 or 27 numbers",
        ValueError,
    ),
    "an unknown controller": (
        lambda prefix: accompanied(make_vec(2) if prefix else make(), ("ResidualAction", "nix")),
        "there is no controller 'nix'; there are adrc-paper",
        ValueError,
    ),
    "no authority": (
        lambda prefix: accompanied(make_vec(2) if prefix else make(), ("ResidualAction", "flatness", 0.0)),
        "authority must be above zero",
        ValueError,
    ),
    "no pace": (
        lambda prefix: accompanied(make_vec(2) if prefix else make(), ("PaceAction", "adrc-matched")),
        "only the flatness-based controller has a pace",
        TypeError,
    ),
}


@pytest.mark.parametrize("many", [False, True], ids=["one", "many"])
@pytest.mark.parametrize(("call", "names", "kind"), BAD.values(), ids=BAD.keys())
def test_an_impossible_companion_is_refused(call: Callable[[Any], Any], names: str, kind: Any, many: bool) -> None:
    assert_refused(lambda: call(many), names, kind)
