"""The learned policies of the package agree with their cards."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.pages import POLICIES, training_seeds
from quadpend_train.policies.loading import load_policies
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.training.callbacks import validate
from quadpend_train.training.settings import read_settings, settings_of_card, to_mapping
from quadpend_train.training.train import CARD_SEED

SEEDS = "apg", "ppo-alone", "sac-alone", "apg-flight", "ppo-flight"  # learners of the tables, with five training seeds
FILES = sorted([*SHIPPED.glob("*.npz"), *(path for path in POLICIES.glob("*.npz") if "vehicles" not in path.stem)])


def test_each_learner_of_the_tables_has_its_training_seeds() -> None:
    for name in SEEDS:
        policies = load_policies(training_seeds(name).rpartition("=")[2])
        assert [policy.card["seed"] for policy in policies] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_card_agrees_with_settings_and_policy(path: Path) -> None:
    name, _, seed = path.stem.rpartition("-")
    card = MlpPolicy.load(path).card
    settings = settings_of_card(card, path.stem)
    assert to_mapping(settings) == {**to_mapping(read_settings(name)), "seed": int(seed)}
    assert card["seed"] == settings.seed
    assert {"hybrid": card["hybrid"]} == settings.policy_interface()
    assert {"score", "curve", "provenance", "seconds", "steps"} <= set(card)
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize("name", ["ppo-alone-0", "apg-flight-0"])
def test_policy_has_the_score_on_its_card(name: str) -> None:
    """This detects changes of the observation and of the use of the action."""
    policy = MlpPolicy.load(name)
    score = validate(policy, settings_of_card(policy.card, name), CARD_SEED)
    assert_allclose(score, [policy.card["score"][key] for key in ("survival", "penalised_rmse")], rtol=1e-3)
    assert np.isfinite(score).all()
