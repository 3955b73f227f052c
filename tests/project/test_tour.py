"""The tour runs cell by cell, with the expected output, and the notebook contains the same cells."""

import re
from pathlib import Path

import nbformat
import pytest
from PIL import Image

from docs.tools.notebook import NOTEBOOK, cells
from tests.helpers.scenarios import shorten_scenarios
from tests.helpers.sources import ROOT

TOUR = ROOT / "docs" / "tour.py"


def test_the_tour_runs_cell_by_cell_from_make_to_a_comparison(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shorten_scenarios(monkeypatch, 2.0)
    tour = TOUR.read_text(encoding="utf-8")
    assert "model.learn(100_000)" in tour
    cells = re.split(r"^# %% ", tour.replace("100_000", "16_384"), flags=re.MULTILINE)[2:]
    assert len(cells) == 10
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile("# " + cell, cell.splitlines()[0], "exec"), names)
    printed = capsys.readouterr().out
    assert "leans 6" in printed
    assert "| windy | learned | 100.0 [" in printed
    with Image.open("tour/flying.png") as picture, Image.open("tour/windy.gif") as video:
        assert picture.size == (640, 480)
        assert video.n_frames > 40  # equal frames are merged


def test_the_notebook_has_the_cells_of_the_tour_with_outputs_and_less_than_a_megabyte() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    written = [(cell.cell_type, cell.source) for cell in cells(TOUR.read_text(encoding="utf-8"))]
    assert [(cell.cell_type, cell.source) for cell in notebook.cells] == written, "run python -m docs.tools.notebook"
    assert (
        sum("image/png" in output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ())) == 3
    )
    assert NOTEBOOK.stat().st_size < 1_000_000
