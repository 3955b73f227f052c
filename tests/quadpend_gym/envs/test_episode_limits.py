"""`max_episode_steps` means the same in `gymnasium.make` and `gymnasium.make_vec`."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeAwareObservation

from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import AUTORESET_MODES, ENDLESS, make, make_vec

SHORT: dict[str, Any] = {"task": ENDLESS, "duration": 0.1}  # 10 steps
KINDS: dict[str, Any] = {
    "make": make,
    "make_vec sync": lambda **kwargs: gym.make_vec("QuadPendulum-v0", 2, vectorization_mode="sync", **kwargs),
    **{
        f"make_vec {mode}": lambda mode=mode, **kwargs: make_vec(2, autoreset_mode=mode, **kwargs)
        for mode in AUTORESET_MODES
    },
}
kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())


def length(env: Any) -> float:
    """Return the number of steps of the first episode, or infinity after 40 steps."""
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    return next((step for step in range(1, 41) if np.any(env.step(action)[2:4])), np.inf)


@kinds
@pytest.mark.parametrize(("limit", "steps"), [(None, 10), (4, 4), (25, 25), (-1, np.inf)])
def test_a_limit_of_steps_replaces_the_duration(kind: Any, limit: int | None, steps: float) -> None:
    env = kind(**SHORT, max_episode_steps=limit) if limit else kind(**SHORT)
    assert length(env) == steps


@kinds
@pytest.mark.parametrize("limit", [0, -2, 1.5, "x"])
def test_a_wrong_limit_of_steps_is_refused(kind: Any, limit: Any) -> None:
    assert_refused(lambda: kind(max_episode_steps=limit), "max_episode_steps")


def test_the_limit_of_a_registration_replaces_the_duration(monkeypatch: pytest.MonkeyPatch) -> None:
    point = "quadpend_gym.envs.env:QuadPendulumEnv"
    monkeypatch.setitem(gym.registry, "Longer-v0", EnvSpec("Longer-v0", point, max_episode_steps=25, kwargs=SHORT))
    assert length(gym.make("Longer-v0")) == 25
    assert length(gym.make("Longer-v0", max_episode_steps=-1)) == np.inf


@pytest.mark.parametrize(("limit", "steps"), [(None, 10), (25, 25)])
def test_a_specification_has_the_limit_of_steps(limit: int | None, steps: int) -> None:
    env = make(**SHORT, max_episode_steps=limit)
    assert env.spec is not None
    assert env.spec.max_episode_steps == length(gym.make(env.spec)) == length(gym.make_vec(env.spec, 2)) == steps
    assert TimeAwareObservation(env).max_timesteps == steps


def test_a_duration_replaces_that_of_a_specification() -> None:
    spec = make(**SHORT).spec
    assert spec is not None
    for again in (gym.make, lambda spec, **kwargs: gym.make_vec(spec, 2, **kwargs)):
        assert length(again(spec, duration=0.2)) == 20
        assert length(again(spec, period=0.02)) == 5
    assert length(gym.make(spec).unwrapped) == spec.max_episode_steps == 10


def test_numpy_numbers_count_as_numbers() -> None:
    one, two = np.int64(1), np.array(2)
    env = make_vec(np.int64(2), max_episode_steps=np.int64(3), num_threads=one, substeps=two, duration=np.float32(5.0))
    assert (env.num_envs, env.max_episode_steps, env.num_threads, env.scenario.substeps) == (2, 3, 1, 2)
    single = make()
    np.testing.assert_array_equal(single.reset(seed=np.int64(4))[0], single.reset(seed=4)[0])
    for wrong in (0, 2.0, True, "2"):
        assert_refused(lambda wrong=wrong: make_vec(wrong), "num_envs must be a whole number")
