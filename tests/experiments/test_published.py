"""The published tables are those of this code: some of their episodes are flown again."""

import numpy as np
import pandas as pd
import pytest

from experiments.results import CLASSICAL, LEARNED, SAMPLE, SAMPLED
from quadpend_gym.scenarios import SETS
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policy

SAMPLES = pd.read_csv(SAMPLE)
POLICIES = (*LEARNED, *CLASSICAL)
FLOWN = 2  # scenarios of each policy; together the policies fly in all of them


@pytest.mark.parametrize("policy", POLICIES)
def test_sampled_episodes_have_their_published_values(policy: str) -> None:
    """Processors round differently, so that chaotic flights such as falls may end differently: only survivors count."""
    mine = SAMPLES[SAMPLES["policy"] == policy]
    names, first = list(dict.fromkeys(mine["scenario"])), FLOWN * POLICIES.index(policy)
    loaded = load_policy(f"{policy}-0" if policy in LEARNED else policy)
    for name in {names[(first + i) % len(names)] for i in range(FLOWN)}:
        stored = mine[mine["scenario"] == name]
        assert len(stored) == SAMPLED
        flown = run_episodes([loaded], name, SAMPLED, TEST_SEED)
        survived = stored["survived"].to_numpy()
        for column in ("steps", "rmse", "settled_rmse", "largest_tilt", "effort"):
            found = getattr(flown, column)[0][survived]
            np.testing.assert_allclose(
                found, stored[column].to_numpy()[survived], rtol=1e-6, err_msg=f"{name}, {column}"
            )


def test_the_sample_has_every_policy_in_every_scenario_but_those_of_slow_ones() -> None:
    counted = SAMPLES.groupby("policy")["scenario"].nunique()
    assert set(counted.index) == set(POLICIES)
    assert (counted.drop("mppi") == len(SETS["test"])).all()
