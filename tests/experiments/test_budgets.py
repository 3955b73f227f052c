"""No learner of the flight benchmark is dominated by a recipe, in the figures of docs/flight/learning.csv."""

import pandas as pd
import pytest

from experiments.budgets import FOLDER
from quadpend_train.policies.loading import shipped_policies
from quadpend_train.training.settings import read_settings

BUDGETS = {"ppo-flight": 1}  # minutes, of the preset of each shipped policy


@pytest.mark.parametrize("name", BUDGETS)
def test_no_recipe_of_the_same_algorithm_is_better_in_less_time(name: str) -> None:
    table = pd.read_csv(FOLDER / "learning.csv").groupby(["learner", "minutes"], as_index=False).median()
    own = table[(table["learner"] == name) & (table["minutes"] == BUDGETS[name])].squeeze()
    same = table[[read_settings(other).algo == read_settings(name).algo for other in table["learner"]]]
    better = (same["wind_multiple"] < own["wind_multiple"]) & (same["wind_survival"] >= own["wind_survival"])
    assert name in shipped_policies()
    assert same[better & (same["processor_seconds"] <= own["processor_seconds"])].empty
