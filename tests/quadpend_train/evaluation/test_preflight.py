"""The data sheet has each limit beside what is needed, and says what to fly first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.cli.main import main
from quadpend_train.evaluation import preflight
from quadpend_train.evaluation.envelope import DELAY, Limit, events
from quadpend_train.evaluation.preflight import CAUGHT, DRAGGED, MEASURED, DataSheet


def test_what_is_not_enough_is_named_and_the_rest_is_flown_in_the_order_of_its_reserve() -> None:
    event = replace(events(SCENARIOS["flight_breeze"])[DELAY], unit="m", everyday=1.0)
    all_events = {"jump": replace(event, commanded=True), "push": replace(event, commanded=True)}
    all_events |= dict.fromkeys((CAUGHT, *MEASURED), event)
    limits = {
        "jump": Limit(2.0, 1.5, np.inf, room=0.5),
        "push": Limit(1.1, 0.5, 1.2),
        CAUGHT: Limit(4.0, 3.0, 5.0, "≥", room=0.8),
        **dict.fromkeys(MEASURED, Limit(9.0, 8.0, np.inf)),
    }
    sheet = DataSheet([("largest thrust", "2.00 weights", "1.3", 1.54, np.nan)], all_events, limits)
    assert sheet.sentences()[1:] == [
        "Warning: not shown to survive everyday strength: push",
        "Smallest reserves: jump (1.5 times), held pole let go (3 times), extra delay (8 times)",
        "Measure before: latency within 4.00 m, pole within 4.00 m, thrust within 4.00 m",
        "Fly first: on the desk; tethered, the pole let go within 1.50 m of upright, with 0.80 m of room; hover in"
        " still air; then jump 0.75 m",
    ]
    assert sheet.table()[1:5] == [
        ("largest thrust", "2.00 weights", "1.3", "1.54", "–"),
        ("jump", "2.00 (1.50, –) m", "1.00 m", "2.00", "0.50"),
        ("push", "1.10 (0.50, 1.20) m", "1.00 m", "1.10", "–"),
        (CAUGHT, "≥ 4.00 (3.00, 5.00) m", "1.00 m", "4.00", "0.80"),
    ]
    weak = replace(sheet, rows=[("largest thrust", "1.20 weights", "1.3", 0.92, np.nan)]).sentences()
    assert weak[1] == "Warning: not enough largest thrust"
    assert weak[-1].startswith("Fly first: nothing")
    below = replace(sheet, limits={**limits, CAUGHT: Limit(0.9, 0.8, 1.0)}).sentences()
    assert below[-2] == DRAGGED
    assert below[-1].startswith("Fly first: nothing")


def test_the_command_prints_a_sheet_of_at_most_30_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(preflight, "limit", lambda policies, event, *_: Limit(1.1 * event.everyday, 0.0, np.inf))
    main(["preflight", "lqg", "--vehicle", "racer", "--episodes", "3", "--jobs", "1", "--cache", str(tmp_path)])
    sheet = capsys.readouterr().out
    assert len(sheet.splitlines()) <= 30
    for text in (
        "lqg on racer",
        "through the loop of flight_breeze (body_rates at 100 Hz",
        "--scenario",
        "survival in flight_breeze",
        "delay margin",
        "start from",
        "extra delay",
        "Measure before: latency within ",
        "Fly first: on the desk; tethered",
    ):
        assert text in sheet
