"""The documents keep their word: every equation has a row, every link a target, every test and function exists."""

import re
from pathlib import Path

import pytest

from baselines.paper.drawing import draw

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "docs/paper.md", ROOT / "docs/derivation.md"]
MAP = (ROOT / "docs/paper.md").read_text(encoding="utf-8")


def test_every_equation_of_the_paper_has_one_row_in_order() -> None:
    assert [int(n) for n in re.findall(r"^\| \((\d+)\) \|", MAP, re.MULTILINE)] == list(range(1, 73))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_has_a_target(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#\s]+)\)", text) + re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)
    assert links
    assert [link for link in links if not (page.parent / link).exists()] == []
    defined = re.findall(r"^\[(`[^\]]+`)\]:", text, re.MULTILINE)
    assert set(re.findall(r"\[(`[^\]]+`)\](?![:(])", text)) <= set(defined)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_test_named_exists(page: Path) -> None:
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", page.read_text(encoding="utf-8")))
    assert named
    assert {name for name in named if f"def {name}(" not in tests} == set()


def test_every_function_of_the_map_is_in_the_file_beside_it() -> None:
    targets = dict(re.findall(r"^\[(`[^\]]+`)\]: (\S+)$", MAP, re.MULTILINE))
    homes = re.findall(r"\[(`\w+\.py`)\]((?: `[\w.]+`,?)+)", MAP)
    assert len(homes) > 50
    for label, names in homes:
        source = (ROOT / "docs" / targets[label]).read_text(encoding="utf-8")
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", names):
            assert re.search(rf"\b(def|class) {name}\b|^{name}\b|, {name} = ", source, re.MULTILINE), (label, name)


def test_the_drawing_is_made_by_code(tmp_path: Path) -> None:
    draw(tmp_path / "frames.svg")
    assert (tmp_path / "frames.svg").read_text(encoding="utf-8").count("<path") > 50
