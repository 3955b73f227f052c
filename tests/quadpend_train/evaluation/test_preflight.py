"""The data sheet has each limit beside what is needed, and says what to fly first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.cli.main import main
from quadpend_train.evaluation import preflight
from quadpend_train.evaluation.envelope import extra_delay
from quadpend_train.evaluation.preflight import DataSheet
from quadpend_train.evaluation.statistics import Interval


def test_what_is_not_enough_is_named_and_the_rest_is_flown_in_the_order_of_its_reserve() -> None:
    event = replace(extra_delay(SCENARIOS["flight_breeze"]), unit="m", everyday=1.0)
    events = {"jump": replace(event, commanded=True), "push": replace(event, commanded=True), "gust": event}
    limits = {"jump": Interval(2.0, 1.0, np.inf), "push": Interval(0.5, 0.0, 1.0), "gust": Interval(4.0, 3.0, 5.0)}
    sheet = DataSheet([("largest thrust", "2.00 weights", "1.3", 1.54)], events, limits)
    assert sheet.sentences() == [
        "Warning: the limit is below the everyday strength of: push",
        "Smallest reserves: jump (2 times), gust (4 times)",
        "Fly first: hover in still air; then, up to 0.5 of the limits and everyday strength, jump 1.00 m",
    ]
    assert sheet.table()[1:3] == [
        ("largest thrust", "2.00 weights", "1.3", "1.54"),
        ("jump", "2.00 [1.00, …] m", "1.00 m", "2.00"),
    ]
    weak = replace(sheet, rows=[("largest thrust", "1.20 weights", "1.3", 0.92)]).sentences()
    assert weak[0] == "Warning: not enough largest thrust"
    assert weak[-1].startswith("Fly first: nothing")
    assert replace(sheet, events={**events, "push": event}).sentences()[-1].startswith("Fly first: nothing")


def test_the_command_prints_a_sheet_of_at_most_25_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(preflight, "limit", lambda policies, event, *_: Interval(1.1 * event.everyday, 0.0, np.inf))
    main(["preflight", "lqg", "--vehicle", "racer", "--episodes", "3", "--jobs", "1", "--cache", str(tmp_path)])
    sheet = capsys.readouterr().out
    assert len(sheet.splitlines()) <= 25
    for text in ("lqg on racer", "survival in flight_breeze", "delay margin", "start from", "extra delay", "Fly first"):
        assert text in sheet
