"""The learned policies of the package are what their cards say."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_train.policies.loading import learners, load_policies
from quadpend_train.policies.mlp_policy import SHIPPED, MlpPolicy
from quadpend_train.training.settings import from_mapping, read_settings, to_mapping
from quadpend_train.training.train import CARD_SEED
from quadpend_train.training.validation import validate

FILES = sorted(SHIPPED.glob("*.npz"))


def test_each_task_has_ppo_and_sac_with_five_seeds() -> None:
    assert {"ppo-pace", "sac-pace", "ppo-pace-hover", "sac-pace-hover"} <= set(learners())
    assert all(len(seeds) == 5 for seeds in learners().values())
    assert len(load_policies("ppo-pace")) == 5


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_a_card_says_what_the_policy_is(path: Path) -> None:
    name, _, seed = path.stem.rpartition("-")
    card = MlpPolicy.load(path).card
    settings = from_mapping(card["settings"], path.stem)
    assert to_mapping(settings) == {**to_mapping(read_settings(name)), "seed": int(seed)}
    assert card["seed"] == settings.seed
    assert card["view"] == settings.view()
    assert {"score", "curve", "scenarios", "origin", "seconds", "steps", "best_at"} <= set(card)
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize("name", ["ppo-pace-0", "sac-pace-hover-1"])
def test_a_policy_flies_as_well_as_its_card_says(name: str) -> None:
    """So whatever changes what it sees, or what becomes of its action, is noticed."""
    policy = MlpPolicy.load(name)
    score = validate(policy, from_mapping(policy.card["settings"], name), CARD_SEED)
    assert_allclose(score, [policy.card["score"][key] for key in ("survival", "penalised_rmse")], rtol=1e-3)
    assert np.isfinite(score).all()
