"""The published tables are those of this code: some of their episodes are flown again."""

import numpy as np
import pandas as pd
import pytest

from experiments.pages import DOCS, SAMPLED
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policy, policy_names

SLOW = ("mppi",)
SAMPLES = {page: pd.read_csv(DOCS / page / "sample.csv") for page in ("results", "flight")}
POLICIES = {page: list(dict.fromkeys(sample["policy"])) for page, sample in SAMPLES.items()}


@pytest.mark.parametrize(
    ("page", "policy"),
    [
        pytest.param(page, policy, marks=pytest.mark.extras if policy in SLOW else ())
        for page, policies in POLICIES.items()
        for policy in policies
    ],
)
def test_sampled_episodes_have_their_published_values(page: str, policy: str) -> None:
    """Each policy flies in one scenario, another one than the policies before it.

    Processors round differently, so that chaotic flights such as falls may end differently: only survivors count.
    """
    mine = SAMPLES[page][SAMPLES[page]["policy"] == policy]
    names, episodes = list(dict.fromkeys(mine["scenario"])), 1 if policy in SLOW else SAMPLED
    name = names[POLICIES[page].index(policy) % len(names)]
    stored = mine[mine["scenario"] == name][:episodes]
    flown = run_episodes([load_policy(policy_names(policy)[0])], name, episodes, TEST_SEED)
    survived = stored["survived"].to_numpy()
    for column in ("steps", "rmse", "settled_rmse", "largest_tilt", "effort"):
        found = getattr(flown, column)[0][survived]
        np.testing.assert_allclose(found, stored[column].to_numpy()[survived], rtol=1e-6, err_msg=f"{name}, {column}")
