"""The learned policies of the package agree with their cards."""

import runpy

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.pages import training_seeds
from quadpend_train.policies.loading import load_policies, shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.callbacks import validate
from quadpend_train.training.settings import read_settings, settings_of_card
from quadpend_train.training.train import CARD_SEED
from tests.helpers.sources import ROOT

SEEDS = "apg", "ppo-alone", "sac-alone", "apg-flight", "ppo-flight"  # learners with five training seeds
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
