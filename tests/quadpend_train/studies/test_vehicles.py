"""The study of real vehicles measures what its tables say, resumes from its cache, and refuses wrong names."""

import json
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.vehicles import VEHICLES
from quadpend_train.cli.main import main
from quadpend_train.studies.recovery import START_LINES, RecoveryMap, RecoveryOutcome, largest_recovered
from quadpend_train.studies.vehicles import WIND_SHARE, vehicle_scenario, windy_scenario


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_the_wind_has_its_share_of_the_weight_on_every_vehicle(vehicle: str) -> None:
    scenario = windy_scenario(vehicle)
    (model,) = scenario.wind.models
    force = np.linalg.norm(np.broadcast_to(model.force, 3))
    assert force == pytest.approx(WIND_SHARE * VEHICLES[vehicle].weight)
    assert scenario.simulation == vehicle_scenario(vehicle).simulation
    assert scenario.simulation.parameters.hover_thrust == pytest.approx(VEHICLES[vehicle].weight)


def test_the_largest_recovered_value_has_no_failure_below_it() -> None:
    values = np.array([0.0, 0.1, 0.2, 0.3])
    for outcomes, largest in (([2, 2, 0, 2], 0.1), ([2, 2, 2, 2], 0.3), ([1, 2, 2, 2], np.nan), ([2, 1, 0, 0], 0.0)):
        found = RecoveryMap(np.array([[outcomes]]), np.zeros((1, 1, 4)))
        np.testing.assert_equal(largest_recovered(found, values), largest)
    both = np.full((2, 4, 1), RecoveryOutcome.RECOVERED)
    both[1, 2] = RecoveryOutcome.FELL
    assert largest_recovered(RecoveryMap(both, np.zeros(both.shape)), values) == 0.1  # all training seeds recover


def test_lines_of_starts_begin_at_hover_and_grow_in_one_quantity() -> None:
    tilted, moving = (grid.options()["state"] for grid in START_LINES.values())
    assert tilted["direction"][0].tolist() == moving["direction"][0].tolist() == [0.0, 0.0, 1.0]
    assert np.all(np.diff(tilted["direction"][:, 0]) > 0.0)
    assert not np.any(tilted["direction_rate"])
    assert np.all(np.diff(moving["direction_rate"][:, 0]) > 0.0)


def test_the_command_writes_tables_and_updates_its_parts_of_a_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = tmp_path / "page.md"
    document.write_text("<!-- begin vehicles-presets -->\n<!-- end vehicles-presets -->\n", encoding="utf-8")
    options = ["--parts", "presets", "--presets", "paper", "--episodes", "2", "--cache", str(tmp_path / "cache")]
    main(["vehicles", "lqr", *options, "--out", str(tmp_path), "--document", str(document)])
    table = (tmp_path / "presets.md").read_text(encoding="utf-8")
    assert table.startswith("| vehicle | air | lqr |\n| --- | --- | --- |\n| paper | calm air | ")
    assert table in document.read_text(encoding="utf-8")
    assert f"presets:\n{table}" in capsys.readouterr().out
    results = json.loads((tmp_path / "presets.json").read_text(encoding="utf-8"))["results"]
    assert results["calm air · paper · lqr"]["survival"]["value"] == 100.0
    assert len(list((tmp_path / "cache").iterdir())) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--parts", "leaderbord"], "there is no part 'leaderbord' (did you mean 'leaderboard'?)"),
        (["--presets", "x5000"], "there is no vehicle 'x5000' (did you mean 'x500'?)"),
        (["ppo-gain-scheduling"], "policies must have a classical controller for the parts other than leaderboard"),
        (["--episodes", "0"], "episodes must be a whole number from 1 to 100000, not 0"),
        (["--document", "missing.md"], "document must be an existing file, not missing.md"),
    ],
)
def test_wrong_input_is_refused_with_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["vehicles", *arguments])
    assert sentence in capsys.readouterr().err
