"""The published tables contain the hash (stamp) of the code that computed them, which equals that of the current code.

If these tests fail, code that determines results has changed since the tables were computed: run `make results`. A
change of comments or docstrings does not change the stamp.
"""

import json
import re

from quadpend_gym.scenarios import SCENARIOS, SETS, scenario_hash
from quadpend_train.evaluation.cache import code_stamp
from tests.helpers.sources import ROOT


def test_the_results_page_contains_the_stamp_of_this_code() -> None:
    text = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    (published,) = re.findall(r"<!-- begin provenance -->\n(.*?)<!-- end provenance -->", text, re.DOTALL)
    assert f"code `{code_stamp()[:12]}`" in published


def test_the_results_file_contains_the_stamps_of_this_code_and_of_the_test_scenarios() -> None:
    with (ROOT / "docs/results/comparison.csv").open(encoding="utf-8") as file:
        published = json.loads(file.readline().removeprefix("# "))
    assert published["code"] == code_stamp()[:12]
    assert published["scenario_hashes"] == {name: scenario_hash(SCENARIOS[name]) for name in SETS["test"]}
