"""Ablations compare two trainings that differ in one part, and their published table has the parts of the code."""

import json
import re
from pathlib import Path

import pytest

from quadpend_train.studies import ablations
from quadpend_train.training.settings import to_mapping
from tests.helpers.bad_input import assert_refused
from tests.helpers.sources import ROOT

ONE_SETTING = ("deso", "kalman", "gsde", "residual-action-relative-reward", "gain-scheduling-relative-reward")


@pytest.mark.parametrize("name", ablations.ABLATIONS)
def test_the_two_trainings_of_an_ablation_differ(name: str) -> None:
    without, added = (to_mapping(settings) for settings in ablations.settings_pair(ablations.ABLATIONS[name], 4))
    assert without != added
    assert without["seed"] == added["seed"] == 4
    if name in ONE_SETTING:
        without, added = ({**settings, "hybrid": None, **settings["hybrid"]} for settings in (without, added))
        assert sum(without[key] != added[key] for key in without) == 1


def test_an_ablation_is_trained_once_and_tabulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablations, "TIMESTEPS", 1)
    monkeypatch.setattr(ablations, "EPISODES", 2)
    result = ablations.run(tmp_path, 2, ("gsde",))["gsde"]
    assert result.difference.low <= result.added.value - result.without.value <= result.difference.high
    with monkeypatch.context() as patch:
        patch.setattr(ablations, "train", None)
        assert ablations.run(tmp_path, 2, ("gsde",)) == {"gsde": result}
    assert "| state-dependent exploration | windy | " in ablations.markdown({"gsde": result})
    assert set(json.loads((tmp_path / "ablations.json").read_text())) == {"gsde"}
    assert_refused(
        lambda: ablations.run(tmp_path, 1, ("nix",)), "no ablation 'nix'; there are sharp-reward", ValueError
    )


def test_the_published_table_has_a_row_for_every_ablation() -> None:
    text = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- begin ablations -->\n(.*?)<!-- end ablations -->", text, re.DOTALL)
    published = [tuple(line.strip("| ").split(" | ")[:2]) for line in table.strip().splitlines()[2:]]
    assert published == [ablations.label(name) for name in (*ablations.ABLATIONS, "constant")]
