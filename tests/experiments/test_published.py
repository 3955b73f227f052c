"""The published tables are those of this code, on every processor: some of their episodes are flown again."""

import pandas as pd
import pytest

from experiments.pages import DOCS
from experiments.samples import LARGEST, PAGES, SLOW, change, fly, tolerance


@pytest.mark.parametrize(
    ("page", "policy"),
    [
        pytest.param(page, policy, marks=pytest.mark.extras if policy in SLOW else ())
        for page, (policies, _) in PAGES.items()
        for policy in policies
    ],
)
def test_sampled_episodes_have_their_published_survival_and_values(page: str, policy: str) -> None:
    table = pd.read_csv(DOCS / page / "sample.csv")
    mine = table[table["policy"] == policy]
    assert mine["rmse"].notna().any()
    assert tolerance(mine["moved"][mine["rmse"].notna()]).max() <= LARGEST
    for scenario, rows in mine.groupby("scenario"):
        stored = rows.set_index("episode")
        found = fly(policy, str(scenario)).loc[stored.index]
        assert found["survived"].equals(stored["survived"]), scenario
        difference = change(stored, found)
        assert not (difference > tolerance(stored["moved"])).any(), f"{scenario}: {difference.to_dict()}"
