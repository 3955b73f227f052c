"""The learned policies of the package agree with their cards."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.pages import training_seeds
from quadpend_train.policies.loading import load_policies, shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.callbacks import validate
from quadpend_train.training.settings import read_settings, settings_of_card
from quadpend_train.training.train import CARD_SEED

SEEDS = "apg", "ppo-alone", "sac-alone", "apg-flight", "ppo-flight"  # learners of the tables, with five training seeds


def test_each_learner_of_the_tables_has_its_training_seeds() -> None:
    for name in SEEDS:
        policies = load_policies(training_seeds(name).rpartition("=")[2])
        assert [policy.card["seed"] for policy in policies] == [0, 1, 2, 3, 4]


def test_cards_of_shipped_policies_have_the_settings_of_their_presets() -> None:
    for name in shipped_policies():
        card = MlpPolicy.load(name).card
        settings = settings_of_card(card, name)
        assert settings == read_settings(name.removesuffix("-0"))
        assert {"hybrid": card["hybrid"]} == settings.policy_interface()
        assert {"score", "curve", "provenance", "seconds", "steps"} <= set(card)


@pytest.mark.parametrize("name", ["ppo-alone-0", "sac-alone-0"])
def test_policy_has_the_score_on_its_card(name: str) -> None:
    """This detects changes of the observation and of the use of the action."""
    policy = MlpPolicy.load(name)
    score = validate(policy, settings_of_card(policy.card, name), CARD_SEED)
    assert_allclose(score, [policy.card["score"][key] for key in ("survival", "penalised_rmse")], rtol=1e-3)
    assert np.isfinite(score).all()
