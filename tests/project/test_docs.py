"""The pages agree with the code: links, names of tests and functions, generated tables and published numbers."""

import re
from pathlib import Path

import pytest

from docs.tools import ranges, settings, vehicles
from quadpend_gym import OBSERVATION_FIELDS, Limits, RewardWeights, Simulation
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.observation import OBSERVATION_SCALE
from tests.helpers.sources import ROOT

DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("*/README.md"), *DOCS.rglob("*.md")])
MAP = (DOCS / "paper.md").read_text(encoding="utf-8")
TASKS = (DOCS / "tasks.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_has_a_target(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)", text)
    links += re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)
    made = ("schemas/", "flying.html")  # written by `make docs`
    assert [link for link in links if not link.startswith(made) and not (page.parent / link).exists()] == []


def test_every_equation_of_the_paper_has_one_row_in_order() -> None:
    assert [int(n) for n in re.findall(r"^\| \((\d+)\) \|", MAP, re.MULTILINE)] == list(range(1, 73))


@pytest.mark.parametrize("name", ["paper.md", "derivation.md"])
def test_every_test_named_exists(name: str) -> None:
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", (DOCS / name).read_text(encoding="utf-8")))
    assert named
    assert {name for name in named if f"def {name}(" not in tests} == set()


def test_every_function_in_the_map_is_defined_in_its_file() -> None:
    targets = dict(re.findall(r"^\[(`[^\]]+`)\]: (\S+)$", MAP, re.MULTILINE))
    entries = re.findall(r"\[(`\w+\.py`)\]((?: `[\w.]+`,?)+)", MAP)
    assert len(entries) > 50
    for label, names in entries:
        source = (DOCS / targets[label]).read_text(encoding="utf-8")
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", names):
            assert re.search(rf"\b(def|class) {name}\b|^{name}\b|, {name} = ", source, re.MULTILINE), (label, name)


@pytest.mark.parametrize("tool", [settings, ranges, vehicles], ids=lambda tool: tool.__name__)
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


def test_the_numbers_of_the_task_equal_those_of_the_code() -> None:
    weights = {row[0].strip("`"): float(row[2]) for row in rows(TASKS, 3) if re.fullmatch(r"0\.\d+", row[2])}
    assert weights == {name: getattr(RewardWeights(), name) for name in ("tracking", "upright", "yaw", "effort")}
    scale = Simulation().command_scale
    for number in (f"u = {scale[0]:g} N", f"= {scale[1]:g} N·m · a₁", f"= {scale[3]:g} N·m · a₃"):
        assert number in TASKS
    assert f"more than {Limits().pendulum_angle * 57.2958:.0f}°" in TASKS
    assert f"exceeds {Limits().tracking_error:g} m" in TASKS


def test_the_results_in_the_readme_are_those_of_the_flight_benchmark() -> None:
    flight = (DOCS / "flight.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- begin flight -->\n(.*?)<!-- end flight -->", README, re.DOTALL)
    ranked = {tuple(row[:3]) for row in rows(flight, 9)}
    ours = [tuple(row[:3]) for row in rows(table, 6)]
    assert "adrc-paper" in {policy for _, policy, _ in ours}
    assert set(ours) <= ranked


def test_the_copies_of_the_ranking_are_equal() -> None:
    ranking = [
        re.search(r"<!-- begin flight-ranking -->.*?<!-- end", (DOCS / name).read_text(encoding="utf-8"), re.DOTALL)
        for name in ("flight.md", "flight/tables.md")
    ]
    assert ranking[0]
    assert ranking[1]
    assert ranking[0][0] == ranking[1][0]
