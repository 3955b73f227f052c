"""The report page is complete in one file, valid, safe against names with markup, and reproducible."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup

from quadpend_baselines import ADRC
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.reports import replay
from quadpend_train.reports.html_page import Section, write
from quadpend_train.studies.perturbations import PERTURBATION_AXES
from quadpend_train.studies.recovery import START_GRIDS
from quadpend_train.studies.robustness import Robustness, measure_robustness

NASTY = "</script><b>\"x\" & 'y'"
SECTIONS = [
    replay.section({"policies": [NASTY], "scenarios": {NASTY: []}}),
    Section("more", "More <3", Markup("<p>soon</p>"), Markup("<style>#more { color: red; }</style>")),
]
VOID = {"meta", "br", "link", "img", "input", "hr"}


class Checker(HTMLParser):
    """A parser that collects tags, ids, links and texts, and fails if tags are not properly nested."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        self.handle_startendtag(tag, attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: Any) -> None:
        self.tags.add(tag)
        self.ids += [value for name, value in attributes if name == "id"]
        self.links += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action", "data")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    policies = {"adrc-paper": [ADRC("paper")], NASTY: [ADRC("matched")]}
    windy = json.dumps({"description": NASTY, "wind": "windy", "duration": 1.0})
    return compare(policies, {"calm": Scenario(duration=1.0), NASTY: windy}, 4)


@pytest.fixture(scope="module")
def robustness(comparison: Comparison) -> Robustness:
    values = np.array([-0.1, 0.0, 0.1])
    x, y = (axis._replace(values=values) for axis in (START_GRIDS["tilt_rate"].x, START_GRIDS["tilt_rate"].y))
    policies = {name: [ADRC()] for name in comparison.policies}
    grids = {"map": replace(START_GRIDS["tilt_rate"], title=NASTY, x=x, y=y)}
    return measure_robustness(policies, {"delay": PERTURBATION_AXES["delay"]}, grids, 4, base=Scenario(duration=1.0))


@pytest.fixture(scope="module")
def page(comparison: Comparison, robustness: Robustness, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write(comparison, leaderboard(comparison), robustness, path, SECTIONS, date="2026-01-01")
    return path.read_text(encoding="utf-8")


def parsed(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    checker.close()
    assert not checker.open
    return checker


def test_all_tags_are_closed_and_ids_are_unique(page: str) -> None:
    checker = parsed(page)
    assert {"table", "svg", "figure", "script", "style", "canvas"} <= checker.tags
    assert "<style>" not in page.partition("</head>")[2]
    assert len(set(checker.ids)) == len(checker.ids)
    assert page.startswith("<!DOCTYPE html>")


def test_the_page_loads_nothing(page: str) -> None:
    checker = parsed(page)
    assert all(link.startswith(("#", "data:")) for link in checker.links)
    assert {link[1:] for link in checker.links if link.startswith("#")} <= set(checker.ids)
    assert not re.search(r"https?:|@import|url\((?!#)|fetch\(|XMLHttp", page)
    assert not {"link", "iframe", "object", "img"} & checker.tags


def test_names_are_escaped(page: str) -> None:
    assert "</script><b>" not in page
    assert "b" not in parsed(page).tags
    assert NASTY in parsed(page).texts
    assert "More <3" in parsed(page).texts


def test_the_page_contains_the_numbers_as_json(page: str, comparison: Comparison) -> None:
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert text
    data = json.loads(text[1])
    assert data["comparison"]["results"] == json.loads(json.dumps(comparison.as_data()["results"]))
    assert set(data["comparison"]["results"]["calm"]) == {"adrc-paper", NASTY}
    assert data["leaderboard"][0]["survival"]["value"] == 100.0
    assert len(data["robustness"]["axes"]["delay"]["curves"]["adrc-paper"]) == len(PERTURBATION_AXES["delay"].values)


def test_pages_of_the_same_data_differ_only_in_the_date(
    page: str, comparison: Comparison, robustness: Robustness, tmp_path: Path
) -> None:
    standings = leaderboard(comparison)
    write(comparison, standings, robustness, tmp_path / "a.html", SECTIONS, date="2026-01-01")
    write(comparison, standings, robustness, tmp_path / "b.html", SECTIONS, date="2026-01-02")
    first, second = ((tmp_path / name).read_text(encoding="utf-8") for name in ("a.html", "b.html"))
    assert first == page
    differing = [a for a, b in zip(first.splitlines(), second.splitlines(), strict=True) if a != b]
    assert differing == ["<dd>2026-01-01</dd>"]


def test_one_policy_in_one_scenario_makes_a_page(tmp_path: Path) -> None:
    comparison = compare({"adrc": [ADRC()]}, {"calm": Scenario(duration=1.0)}, 2)
    write(comparison, leaderboard(comparison), None, tmp_path / "sub" / "page.html")
    checker = parsed((tmp_path / "sub" / "page.html").read_text(encoding="utf-8"))
    assert "robustness" not in checker.ids
    assert "1 policy in 1 scenario, 2 episodes in each" in " ".join(checker.texts).replace("\n", " ")


def test_robustness_of_other_policies_is_an_error(robustness: Robustness, tmp_path: Path) -> None:
    comparison = compare({"adrc": [ADRC()]}, {"calm": Scenario(duration=1.0)}, 2)
    with pytest.raises(ValueError, match="robustness must be of adrc, not adrc-paper"):
        write(comparison, leaderboard(comparison), robustness, tmp_path / "page.html")
