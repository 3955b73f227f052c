"""Wrappers that change the observation: output feedback and histories."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, OUTPUT_FEEDBACK
from tests.helpers.envs import draw_actions, run_actions
from tests.helpers.wrappers import (
    ACTUATORS,
    HISTORY,
    NOISE,
    OUTPUTS,
    SENSORS,
    make_wrapped,
    make_wrapped_vec,
)

SIZES = [(4, 0), (3, 2), (1, 3), (2, 5)]  # observations and actions of a history
sizes = pytest.mark.parametrize(("observations", "actions"), SIZES)


@pytest.mark.parametrize("name", ["adrc-paper", "adrc-matched"])
def test_the_papers_controller_uses_no_velocities(name: str) -> None:
    """Its actions on 27 numbers equal those on 36."""
    layers = [("wind", "breeze"), ("sensors", NOISE)]
    whole, outputs = make_wrapped_vec(3, layers), make_wrapped_vec(3, [*layers, OUTPUTS])
    memories = [None, None]
    policies = [controller(name).adapt(Scenario(observation=fields)) for fields in (FULL, OUTPUT_FEEDBACK)]
    observations = [whole.reset(seed=0)[0], outputs.reset(seed=0)[0]]
    for _ in range(100):
        actions: Any
        flown = zip(policies, observations, memories, strict=True)
        actions, memories = zip(*(policy.predict(*given) for policy, *given in flown), strict=True)
        assert_array_equal(actions[0], actions[1])
        observations = [env.step(action)[0] for env, action in zip((whole, outputs), actions, strict=True)]


def last(items: list[Any], count: int, before: Any) -> list[Any]:
    """Return the last `count` items, oldest first, padded with `before` in front."""
    return [before] * max(count - len(items), 0) + items[max(len(items) - count, 0) :]


@sizes
def test_a_history_has_the_latest_observations_and_actions_oldest_first(observations: int, actions: int) -> None:
    """The actions are those before the actuators; zeros stand for actions before the first."""
    env = make_wrapped([ACTUATORS, SENSORS, ("HistoryWrapper", observations, actions)])
    plain = make_wrapped([ACTUATORS, SENSORS])
    assert env.observation_space.shape == (36 * observations + 4 * actions,)
    for seed in (0, None):
        history, (first, _) = env.reset(seed=seed)[0], plain.reset(seed=seed)
        observed: list[Floats32] = [first]
        applied: list[Any] = []
        for action in draw_actions(0, 10):
            expected = [*last(observed, observations, first), *last(applied, actions, np.zeros(4))]
            assert history.dtype == np.float32
            assert_array_equal(history, np.concatenate(expected))
            history = env.step(action)[0]
            observed.append(plain.step(action)[0])
            applied.append(action)


def test_a_masked_reset_keeps_the_histories_of_the_other_sub_environments() -> None:
    env, untouched = (make_wrapped_vec(3, [HISTORY]) for _ in range(2))
    env.reset(seed=0), untouched.reset(seed=0)
    actions = draw_actions(0, 4, 3)
    history = run_actions(env, actions)[-1][0]
    run_actions(untouched, actions)
    mask = np.array([False, True, False])
    restarted = env.reset(options={"reset_mask": mask})[0]
    assert_array_equal(restarted[~mask], history[~mask])
    assert_array_equal(restarted[1], np.concatenate([*[restarted[1, :36]] * 3, np.zeros(8)]))
    assert_array_equal(env.step(actions[0])[0][~mask], untouched.step(actions[0])[0][~mask])
