"""The published tables are those of this code, on every processor: some of their episodes are flown again."""

import numpy as np
import pandas as pd
import pytest

from experiments import samples
from experiments.pages import DOCS
from experiments.samples import LARGEST, PAGES, VALUES, change, fly, tolerance


@pytest.mark.parametrize(
    ("page", "policy"),
    [(page, policy) for page, (policies, _) in PAGES.items() for policy in policies],
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
        difference = change(stored, found)[stored["rmse"].notna()]
        assert (difference <= tolerance(stored["moved"])[difference.index]).all(), f"{scenario}: {difference.to_dict()}"


def test_what_a_start_1_nm_away_changes_too_much_is_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    def flown(policy: str, scenario: str, move: float = 0.0) -> pd.DataFrame:
        table = pd.DataFrame({"survived": [True] * 4 + [move >= 0.0], **dict.fromkeys(VALUES, 1.0)})
        lost = np.nan if move else 1.0
        return table.assign(rmse=[1.0, 1.0 + 1e6 * max(move, 0.0), 1.0 + 1e6 * min(move, 0.0), lost, 1.0])

    monkeypatch.setattr(samples, "fly", flown)
    rows = samples.sample("lqr", "calm")
    assert rows["episode"].tolist() == [0, 1, 2, 3]
    assert rows["rmse"].isna().tolist() == [False, True, True, True]
