"""A cautious companion trusts its learner less where actions come late, or where the pendulum leans far."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from quadpend_baselines.hybrid.companion import Companion, CompanionMemory

from quadpend_baselines import controller
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.scenarios import find_scenario
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import make_vec
from tests.helpers.hybrid import Steered, constant, flown
from tests.helpers.mlp_policies import card, layers

SAME_STEP = {"autoreset_mode": "SameStep"}
BEGINNING = np.ones(3, np.bool_)


def cautious(caution: float = 1.0, steers: str = "pace") -> Companion:
    return Companion(controller("flatness"), steers, 0.5, caution)


def watched(companion: Companion, **reset: Any) -> CompanionMemory:
    observation, _ = make_vec(3, **SAME_STEP).reset(seed=0, **reset)
    return companion.watch(observation, None, BEGINNING)[1]


@pytest.mark.parametrize("steers", ["action", "pace"])
@pytest.mark.parametrize(("doubt", "caution", "trust"), [(1.0, 1.0, 0.5), (3.0, 1.0, 0.1), (1.5, 2.0, 0.1)])
def test_what_the_learner_asks_for_counts_by_how_far_it_is_trusted(
    steers: str, doubt: float, caution: float, trust: float
) -> None:
    action = np.tile(np.float32([0.2, -0.6, 0.4, 0.8]), (3, 1))
    companion = cautious(caution, steers)
    memory = watched(companion)._replace(doubt=np.full(3, doubt))
    acting, _ = companion.act(action, memory)
    expected, _ = cautious(0.0, steers).act(np.float32(trust) * action, memory)
    assert_allclose(acting, expected, atol=1e-6)


def test_without_caution_it_is_trusted_whatever_happens() -> None:
    learner = constant(1.0, 1.0, 1.0, 1.0)
    env = {"wind": "storm", **SAME_STEP}
    trusting, bare = (
        flown(Steered(companion, learner), make_vec(3, **env), 40)[0]
        for companion in (cautious(0.0), Companion(controller("flatness"), "pace", 0.5))
    )
    assert_array_equal(trusting, bare)


def test_a_pendulum_that_leans_far_is_a_doubt_that_fades_by_one_in_a_hundred_a_step() -> None:
    companion = cautious()
    leaning = watched(companion, options={"state": {"direction": (0.3, 0.4, np.sqrt(0.75))}})
    assert_allclose(leaning.doubt, 0.5 / 0.2, rtol=1e-6)
    env = make_vec(3, **SAME_STEP)
    observation, _ = env.reset(seed=0)
    _, memory = companion.watch(observation, None, BEGINNING)
    action, memory = companion.act(np.zeros((3, 4), np.float32), memory._replace(doubt=np.full(3, 5.0)))
    _, later = companion.watch(env.step(action)[0], memory, np.array([False, False, True]))
    assert_allclose(later.doubt[:2], 0.99 * 5.0)
    assert later.doubt[2] < 0.3, "an episode that begins knows of no earlier one"


def doubts(scenario: str) -> Floats:
    """Equation (4)'s q over two seconds of eight flights, shape (200, 8)."""
    env = find_scenario(scenario).make_vec(8, AutoresetMode.SAME_STEP, 200)
    steps = rollout(Steered(cautious()), env, VALIDATION_SEED)
    return np.array([step.memory.doubt for step in steps])


def test_late_actions_are_noticed_within_half_a_second_and_wind_is_not_taken_for_them() -> None:
    assert doubts("training_lagged")[50:].min() > 2.0
    assert np.median(doubts("windy")[50:]) < 0.5
    assert np.median(doubts("turbulence")[50:]) < 1.0


@pytest.mark.parametrize(
    ("steers", "caution", "message"),
    [
        ("pace", -1.0, "caution .* not -1"),
        ("pace", 11.0, "caution .* not 11"),
        ("pace", np.nan, "caution .* not nan"),
        ("alone", 1.0, "acts alone has no controller to fall back on: caution must be 0, not 1"),
    ],
)
def test_impossible_caution_is_refused(steers: str, caution: float, message: str) -> None:
    assert_refused(lambda: cautious(caution, steers), message, ValueError)


def test_a_card_that_knows_no_caution_means_none() -> None:
    old = card()
    del old["view"]["caution"]
    assert MlpPolicy(layers(36, 8, 4), old).card == card()
