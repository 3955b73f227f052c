"""The pages agree with the code: links, names of tests and functions, generated tables and published numbers."""

import re
from pathlib import Path

import pytest

from docs.tools import fields, settings, vehicles
from quadpend_gym import OBSERVATION_FIELDS
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.observation import OBSERVATION_SCALE
from tests.helpers.sources import ROOT

DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("*/README.md"), *DOCS.rglob("*.md")])
TASKS = (DOCS / "tasks.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
MOST_PAGES, MOST_WORDS = 34, 40_000  # of docs/ and README together, generated tables included


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_has_a_target(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)", text)
    links += re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)
    made = "schemas/"  # written by `make docs`
    assert [link for link in links if not link.startswith(made) and not (page.parent / link).exists()] == []


def test_docs_stay_short_enough_to_be_read() -> None:
    pages = [ROOT / "README.md", *DOCS.rglob("*.md")]
    assert len(pages) <= MOST_PAGES
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in pages) <= MOST_WORDS
    assert README.count("\n") <= 100


@pytest.mark.parametrize("tool", [settings, fields, vehicles], ids=lambda tool: tool.__name__)
def test_generated_tables_are_those_of_the_code(tool: object) -> None:
    page = tool.PAGE.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    missing = [name for name, table in tool.tables().items() if table not in page]  # type: ignore[attr-defined]
    assert missing == [], "run python -m " + tool.__name__  # type: ignore[attr-defined]


def rows(text: str, columns: int) -> list[list[str]]:
    """The cells of all table rows of a page that have this number of columns."""
    lines = re.findall(r"^\| (.*) \|$", text, re.MULTILINE)
    return [cells for line in lines if len(cells := re.split(r" \| ", line)) == columns]


def test_the_tables_of_observation_and_state_equal_their_layouts() -> None:
    table = {row[1].strip("`"): (row[0], row[4]) for row in rows(TASKS, 5) if "–" in row[0]}
    assert list(table) == list(OBSERVATION_FIELDS)
    for name, columns in OBSERVATION_FIELDS.items():
        assert table[name][0] == f"{columns.start}–{columns.stop - 1}"
        assert (OBSERVATION_SCALE[columns] == [float(scale) for scale in table[name][1].split(",")]).all()
    states = {row[1].strip("`"): row[0] for row in rows((DOCS / "frames.md").read_text("utf-8"), 5) if "–" in row[0]}
    assert states == {name: f"{part.start}–{part.stop - 1}" for name, part in STATE_FIELDS.items()}


def test_the_results_in_the_readme_are_those_of_the_flight_benchmark() -> None:
    flight = (DOCS / "flight.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- begin flight -->\n(.*?)<!-- end flight -->", README, re.DOTALL)
    ours = rows(table, 6)
    assert any("adrc-paper" in row for row in ours)
    assert all(row in rows(flight, 6) for row in ours)
