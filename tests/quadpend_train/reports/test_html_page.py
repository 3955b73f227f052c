"""The report page is complete in one file, valid, safe against names with markup, and reproducible."""

import json
import re
from html.parser import HTMLParser
from typing import Any

import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.reports.html_page import write

NASTY = "</script><b>\"x\" & 'y'"
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
    policies = {"adrc-paper": [controller("adrc-paper")], NASTY: [controller("adrc-matched")]}
    windy = json.dumps({"description": NASTY, "wind": "windy", "period": 0.005, "duration": 0.5})
    return compare(policies, {"calm": Scenario(duration=1.0), NASTY: windy}, 4)


@pytest.fixture(scope="module")
def page(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write(comparison, path)
    return path.read_text(encoding="utf-8")


def parsed(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    checker.close()
    assert not checker.open
    return checker


def test_all_tags_are_closed_and_ids_are_unique(page: str) -> None:
    checker = parsed(page)
    assert {"table", "svg", "figure", "script", "style"} <= checker.tags
    assert "<style>" not in page.partition("</head>")[2]
    assert len(set(checker.ids)) == len(checker.ids)
    assert page.startswith("<!DOCTYPE html>")
    assert all(text in page for text in ("0.5&nbsp;s", "200&nbsp;Hz", "1&nbsp;s", "100&nbsp;Hz"))


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
