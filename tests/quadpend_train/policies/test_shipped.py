"""The learned policies of the package agree with their cards."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_train.policies.loading import load_policies, shipped_policies
from quadpend_train.policies.mlp_policy import PLAIN_INTERFACE, SHIPPED, MlpPolicy
from quadpend_train.training.callbacks import validate
from quadpend_train.training.settings import read_settings, settings_of_card, to_mapping
from quadpend_train.training.train import CARD_SEED

SEEDS = {  # number of training seeds of each learned policy
    **dict.fromkeys(("apg", "ppo-alone", "sac-alone", "ppo-gain-scheduling"), 5),
    **dict.fromkeys(("ppo-swing-up", "ppo-swing-up-wind", "sac-swing-up", "ppo-flight", "apg-flight"), 5),
    **dict.fromkeys(("ppo-load", "sac-load", "ppo-recovery", "sac-recovery", "ppo-agile", "sac-agile"), 1),
    **dict.fromkeys(("apg-loops", "apg-vehicles", "apg-vehicles-safe", "dagger-vehicles"), 1),
}
FILES = sorted(SHIPPED.glob("*.npz"))


def own_start(name: str, seed: str) -> dict[str, str]:
    """Return the setting that differs between the training seeds of a policy, if there is one."""
    return {"start_from": f"ppo-swing-up-{seed}"} if name == "ppo-swing-up-wind" else {}


def test_each_learned_policy_has_its_seeds() -> None:
    assert {name: len(seeds) for name, seeds in shipped_policies().items()} == SEEDS
    assert len(load_policies("ppo-gain-scheduling")) == 5


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_card_agrees_with_settings_and_policy(path: Path) -> None:
    name, _, seed = path.stem.rpartition("-")
    card = MlpPolicy.load(path).card
    settings = settings_of_card(card, path.stem)
    assert to_mapping(settings) == {**to_mapping(read_settings(name)), "seed": int(seed), **own_start(name, seed)}
    assert card["seed"] == settings.seed
    assert {name: card[name] for name in PLAIN_INTERFACE} == settings.policy_interface()
    assert {"score", "curve", "provenance", "seconds", "steps"} <= set(card)
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize("name", ["ppo-gain-scheduling-0", "ppo-alone-1"])
def test_policy_has_the_score_on_its_card(name: str) -> None:
    """This detects changes of the observation and of the use of the action."""
    policy = MlpPolicy.load(name)
    score = validate(policy, settings_of_card(policy.card, name), CARD_SEED)
    assert_allclose(score, [policy.card["score"][key] for key in ("survival", "penalised_rmse")], rtol=1e-3)
    assert np.isfinite(score).all()
