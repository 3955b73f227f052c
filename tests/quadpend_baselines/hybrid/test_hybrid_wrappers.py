"""The wrapper of hybrids equals single environments in every autoreset mode."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import SyncVectorEnv
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import (
    EstimateOnly,
    ResidualAction,
    VectorHybridWrapper,
)
from quadpend_gym import Simulation
from quadpend_gym.envs.spaces import observation_space
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import AUTORESET_MODES, assert_same, draw_actions, make_vec, run_actions
from tests.helpers.wrappers import (
    HISTORY,
    OUTPUTS,
    SENSORS,
    SHORT,
    WIND,
    biased_actions,
    make_wrapped,
    make_wrapped_vec,
)

KINDS = [EstimateOnly("adrc-matched"), ResidualAction("flatness", 0.3)]
hybrids = pytest.mark.parametrize("hybrid", KINDS, ids=lambda hybrid: hybrid.kind)
LAYERS = [WIND, SENSORS, OUTPUTS]


class Single(gym.Wrapper[Any, Any, Any, Any]):
    """A hybrid around a single environment."""

    def __init__(self, env: Any, hybrid: Any) -> None:
        super().__init__(env)
        self.hybrid = hybrid.designed_for(Simulation(), Loop(observation=OUTPUT_FEEDBACK))
        self.observation_space = observation_space(hybrid.observation_size(27))

    def reset(self, **options: Any) -> Any:
        observation, info = self.env.reset(**options)
        seen, self.memory = self.hybrid.observe(observation[np.newaxis], None, np.array([True]))
        return seen[0], info

    def step(self, action: Any) -> Any:
        applied, memory = self.hybrid.act(action[np.newaxis], self.memory)
        observation, *rest = self.env.step(applied[0])
        seen, self.memory = self.hybrid.observe(observation[np.newaxis], memory, np.array([False]))
        return seen[0], *rest


BRIEF = {**SHORT, "max_episode_steps": 9}


@pytest.mark.parametrize("mode", AUTORESET_MODES)
@hybrids
def test_vector_wrapper_equals_wrapped_single_environments(hybrid: Any, mode: str) -> None:
    """Exactly, across the ends of several episodes, final observations included."""
    env = VectorHybridWrapper(make_wrapped_vec(3, LAYERS, autoreset_mode=mode, **BRIEF), hybrid)
    theirs: Any = SyncVectorEnv([lambda: Single(make_wrapped(LAYERS, **BRIEF), hybrid)] * 3, autoreset_mode=mode)
    assert env.observation_space == theirs.observation_space
    assert_array_equal(env.reset(seed=7)[0], theirs.reset(seed=7)[0])
    ended = np.zeros(3, np.int64)
    for action in biased_actions(30, 3):
        *returned, info = env.step(action)
        *their_return, their_info = theirs.step(action)
        assert_same(returned, their_return)
        over = returned[2] | returned[3]
        ended += over
        for row in np.flatnonzero(over) if mode == "SameStep" else ():
            assert_array_equal(info["final_obs"][row], their_info["final_obs"][row])
        if mode == "Disabled" and over.any():
            mask = {"reset_mask": over}
            assert_array_equal(env.reset(options=mask)[0], theirs.reset(options=mask)[0])
    assert ended.min() >= 2


def test_a_base_controller_with_a_name_is_designed_for_the_environment_and_an_object_is_not() -> None:
    slow = Simulation(period=0.02, substeps=4)
    env, wrap = make_vec(2, period=0.02), VectorHybridWrapper
    assert wrap(env, EstimateOnly("lqr")).hybrid.controller.simulation == slow
    assert wrap(env, {"kind": "estimate_only", "base_controller": "lqr"}).hybrid.controller.simulation == slow
    assert wrap(env, EstimateOnly(controller("lqr"))).hybrid.controller.simulation == Simulation()


def test_actions_that_the_environment_would_refuse_change_nothing() -> None:
    env, copy = (VectorHybridWrapper(make_vec(3), KINDS[1]) for _ in range(2))
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((3, 4)))
    env.reset(seed=0), copy.reset(seed=0)
    for bad, names in ((np.full((3, 4), 1.5), "numbers in"), (np.zeros((3, 3)), r"shape .*4")):
        with pytest.raises(ValueError, match=names):
            env.step(bad)
    actions = 0.1 * draw_actions(0, 3, 3)
    assert_same(run_actions(env, actions), run_actions(copy, actions))


def test_environments_with_other_observations_are_refused() -> None:
    message = "the observation 'full' or 'output_feedback'.*, not .*116.*: put its wrapper inside"
    assert_refused(lambda: VectorHybridWrapper(make_wrapped_vec(2, [HISTORY]), KINDS[1]), message, ValueError)
