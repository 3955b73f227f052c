"""The published tables are those of this code: some of their episodes are flown again."""

import numpy as np
import pandas as pd
import pytest

from experiments.results import CLASSICAL, LEARNED, SAMPLE, SAMPLED, SLOW
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policy

SAMPLES = pd.read_csv(SAMPLE)
POLICIES = (*LEARNED, *CLASSICAL)


@pytest.mark.parametrize(
    "policy", [pytest.param(name, marks=pytest.mark.extras if name in SLOW else ()) for name in POLICIES]
)
def test_sampled_episodes_have_their_published_values(policy: str) -> None:
    """Each policy flies in one scenario, another one than the policies before it.

    Processors round differently, so that chaotic flights such as falls may end differently: only survivors count.
    """
    mine = SAMPLES[SAMPLES["policy"] == policy]
    names, episodes = list(dict.fromkeys(mine["scenario"])), 1 if policy in SLOW else SAMPLED
    name = names[POLICIES.index(policy) % len(names)]
    stored = mine[mine["scenario"] == name][:episodes]
    flown = run_episodes([load_policy(f"{policy}-0" if policy in LEARNED else policy)], name, episodes, TEST_SEED)
    survived = stored["survived"].to_numpy()
    for column in ("steps", "rmse", "settled_rmse", "largest_tilt", "effort"):
        found = getattr(flown, column)[0][survived]
        np.testing.assert_allclose(found, stored[column].to_numpy()[survived], rtol=1e-6, err_msg=f"{name}, {column}")
