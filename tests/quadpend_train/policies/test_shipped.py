"""The learned policies of the package agree with their cards."""

import runpy
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.pages import training_seeds
from quadpend_gym.scenarios import as_scenario
from quadpend_gym.tasks.observation import LAB
from quadpend_train.policies.loading import load_policies, shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.callbacks import validate
from quadpend_train.training.settings import read_settings, settings_of_card
from quadpend_train.training.train import CARD_SEED
from tests.helpers.sources import ROOT

SEEDS = "lab", "apg", "ppo-alone", "sac-alone", "apg-flight", "ppo-flight"  # learners with five training seeds
SCRIPTED = {"lab-0"}  # trained by a script, without a preset


def test_each_learner_of_the_tables_has_its_training_seeds() -> None:
    for name in SEEDS:
        policies = load_policies(training_seeds(name).rpartition("=")[2])
        assert [policy.card["seed"] for policy in policies] == [0, 1, 2, 3, 4]


def test_cards_of_shipped_policies_have_the_settings_of_their_presets() -> None:
    for name in set(shipped_policies()) - SCRIPTED:
        card = MlpPolicy.load(name).card
        settings = settings_of_card(card, name)
        assert settings == read_settings(name.removesuffix("-0"))
        assert {"hybrid": card["hybrid"]} == settings.policy_interface()
        assert {"score", "curve", "provenance", "seconds", "steps"} <= set(card)


@pytest.mark.parametrize("name", sorted(SCRIPTED))
def test_cards_of_policies_of_a_script_have_its_settings(name: str) -> None:
    card = MlpPolicy.load(name).card
    script = runpy.run_path(str(ROOT / card["script"]["file"]))
    assert {*script["SETTINGS"]} <= set(card["script"])
    assert card["script"]["seeds"] == [card["seed"]]
    assert card["script"]["scenarios"] == [*script["CHANGES"], *script["POLES"]]
    assert card["provenance"]["command"][:2] == ["python", card["script"]["file"]]
    assert {"seconds", "steps", "device"} <= set(card)


@pytest.mark.parametrize("name", ["ppo-alone-0", "sac-alone-0"])
def test_policy_has_the_score_on_its_card(name: str) -> None:
    """This detects changes of the observation and of the use of the action."""
    policy = MlpPolicy.load(name)
    score = validate(policy, settings_of_card(policy.card, name), CARD_SEED)
    assert_allclose(score, [policy.card["score"][key] for key in ("survival", "penalised_rmse")], rtol=1e-3)
    assert np.isfinite(score).all()


@pytest.mark.parametrize(
    ("field", "axis", "distance"),
    [("reference_0", 0, 8.0), ("reference_0", 2, -1.5), ("position", 0, 0.3)],
    ids=["a place far away", "a fall", "a mistake of motion capture"],
)
def test_lab_0_bears_a_step(field: str, axis: int, distance: float) -> None:
    """Of the set-point or of the measured position, after 2 s."""
    scenario = as_scenario("flight_breeze", duration=10.0, task={"limits": {"tracking_error": 50.0}})
    policy: Any = load_policies("lab-0")[0].adapt(scenario)
    env, memory, started = scenario.make_vec(4), None, np.ones(4, np.bool_)
    observation, info = env.reset(seed=3)
    for step in range(scenario.steps - 1):
        observation[:, LAB.columns[field].start + axis] += distance * (step >= 200)
        action, memory = policy.predict(observation, memory, started)
        observation, _, started, _, info = env.step(action)
        assert not started.any(), step
    expected = distance if field == "reference_0" else -distance
    assert_allclose(info["tracking_error"][:, axis], expected, atol=0.1)
