"""The flying page: its files are those of its sources, it flies as Python does, and a visitor can disturb it."""

import json
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs.tools import flying_page
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_train.export import to_c
from quadpend_train.policies.loading import load_policy
from tests.helpers.browser import Browser, start

POLICIES = list(flying_page.POLICIES)
# Constant events, for the page and for the environment
LATE, HAND = 5, [0.03, 0.04]
PUSH: dict[str, Any] = {"kind": "constant", "force": [0.1, -0.15, 0.05], "bob_force": [0.01, 0.015, -0.005]}
HOLD = {"kind": "hold", "distance": 0.0, "point": HAND, "until": 1e6}
ROOM = {name: [1.1 * value] * 2 for name, value in (("bob_mass", 0.05), ("rod_length", 0.565))}
CASES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    *((name, {"forces": PUSH["force"] + PUSH["bob_force"]}, {"wind": PUSH}) for name in POLICIES),
    ("lqg", {"hand": HAND, "delay": LATE, "growth": 1.1}, {"wind": HOLD, "latency": 0.0325, "parameters": ROOM}),
]
ERROR = "flying.sides[1].curves.at(-1).points.at(-1)?.[1]"  # mm, the last error of the vehicle B


def test_the_page_is_that_of_its_sources(tmp_path: Path) -> None:
    assert flying_page.compiled_hash() == flying_page.write_c(tmp_path), "run make flying"
    assert flying_page.PAGE.read_text(encoding="utf-8") == flying_page.page(flying_page.compiled()), "run make flying"
    assert flying_page.PAGE.stat().st_size < 600_000


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with closing(start(tmp_path_factory.mktemp("flying") / "profile")) as browser:
        browser.call("Emulation.setDeviceMetricsOverride", width=1280, height=620, deviceScaleFactor=1, mobile=False)
        browser.open(flying_page.PAGE)
        browser.wait("Boolean(flying.fly)")
        yield browser


def flown_by_python(name: str, events: dict[str, Any]) -> Floats:
    """States of two seconds, shape (200, 18)."""
    pilot = to_c.adapt(load_policy(name), name, flying_page.DESIGN, flying_page.GAIN_STEPS)
    env = flying_page.flown(**events).make_vec(1)
    (observation, _), memory, states = env.reset(seed=0), None, []
    for step in range(200):
        action, memory = pilot.predict(observation, memory, np.array([step == 0]))
        observation, *_ = env.step(action)
        states.append(env.unwrapped.world.state[0].copy())  # type: ignore[attr-defined]
    return np.array(states)


@pytest.mark.parametrize(("name", "exposure", "events"), CASES)
def test_a_flight_of_two_seconds_is_that_of_python(
    page: Browser, name: str, exposure: dict[str, Any], events: dict[str, Any]
) -> None:
    """Rounding of actions to single precision makes differences of 1e-16 grow, most in the rates of ADRC."""
    atol = 6e-8 if name == "lab-0" else 1e-9  # that network computes in single precision: its rounding unit
    found = np.array(page.run(f"flying.fly({POLICIES.index(name)}, {json.dumps(exposure)}, 200)"))
    exact = flown_by_python(name, events)
    np.testing.assert_allclose(found[:10], exact[:10], rtol=0.0, atol=atol)
    for part in ("position", "euler", "direction"):
        np.testing.assert_allclose(getattr(State(found), part), getattr(State(exact), part), rtol=0.0, atol=1e-5)


def test_the_page_fetches_nothing_and_reports_no_error(page: Browser) -> None:
    assert page.run("performance.getEntriesByType('resource').length") == 0
    assert page.messages() == []


def test_the_script_of_a_frame_takes_at_most_4_ms_of_processor_time(page: Browser) -> None:
    """The median of twelve quarters of a second, since the browser also compiles and collects garbage."""
    page.call("Performance.enable", timeDomain="threadTicks")

    def now() -> tuple[float, int]:
        metrics = {one["name"]: one["value"] for one in page.call("Performance.getMetrics")["metrics"]}
        return 1e3 * metrics["ScriptDuration"], page.run("flying.frames")

    times, (before, frames) = [], now()
    for _ in range(12):
        page.wait(f"flying.frames >= {frames + 15}")
        after, count = now()
        times.append((after - before) / (count - frames))
        before, frames = after, count
    assert np.median(times) <= 4.0, times


def drag(page: Browser, pointer: str, kind: str, x: float, y: float) -> None:
    if pointer == "mouse":
        page.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", buttons=1, clickCount=1)
    else:
        touch = {"Pressed": "touchStart", "Moved": "touchMove", "Released": "touchEnd"}[kind]
        page.call("Input.dispatchTouchEvent", type=touch, touchPoints=[] if kind == "Released" else [{"x": x, "y": y}])


def press(page: Browser, name: str, code: int, *kinds: str) -> None:
    for kind in kinds or ("rawKeyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, key=name, windowsVirtualKeyCode=code)


def reset_without_wind(page: Browser) -> None:
    page.run("document.getElementById('wind').value = 0; document.getElementById('reset').click()")
    page.wait(f"{ERROR} < 5")


@pytest.mark.extras
@pytest.mark.parametrize("pointer", ["mouse", "touch"])
def test_a_pushed_vehicle_recovers_and_a_fallen_one_begins_again(page: Browser, pointer: str) -> None:
    reset_without_wind(page)
    x, y = page.run("flying.bob(1)")
    drag(page, pointer, "Pressed", x, y)
    drag(page, pointer, "Moved", x + 60, y)
    page.wait(f"{ERROR} > 100")
    drag(page, pointer, "Released", x + 60, y)
    page.wait(f"{ERROR} < 50")
    assert page.run("flying.sides[1].falls") == 0
    x, y = page.run("flying.bob(1)")
    drag(page, pointer, "Pressed", x, y)
    drag(page, pointer, "Moved", x + 400, y)
    page.wait("flying.sides[1].fell !== null")
    drag(page, pointer, "Released", x + 400, y)
    page.wait("flying.sides[1].fell === null")
    assert page.run("flying.sides[1].falls") == 1
    page.wait(f"{ERROR} < 5")


@pytest.mark.extras
def test_keys_push_pause_reset_and_turn_the_wind_up(page: Browser) -> None:
    """Arrows also push while a button has the focus, as after a click on it."""
    reset_without_wind(page)
    page.run("document.getElementById('reset').focus()")
    press(page, "ArrowRight", 39, "rawKeyDown")
    page.wait(f"{ERROR} > 50")
    press(page, "ArrowRight", 39, "keyUp")
    page.wait(f"{ERROR} < 20")
    page.run("document.getElementById('view').focus()")
    press(page, " ", 32)
    frames = page.run("flying.frames")
    page.run("new Promise(requestAnimationFrame)")
    assert page.run("flying.frames") == frames
    press(page, "r", 82)
    assert page.run("flying.sides[1].curves.at(-1).points.length") == 0
    press(page, " ", 32)
    page.wait(f"flying.frames > {frames}")
    page.run("document.getElementById('wind').focus()")
    press(page, "ArrowRight", 39)
    assert page.run("document.getElementById('wind').value") == "0.1"


@pytest.mark.extras
@pytest.mark.parametrize(("name", "falls"), [("jump", 0), ("blind", 0), ("hand", 1), ("pole", 0)])
def test_an_event_of_everyday_strength_fells_only_whom_the_data_sheet_says(
    page: Browser, name: str, falls: int
) -> None:
    """B is the network that falls when a hand lets the pole go; A is `lqg`."""
    reset_without_wind(page)
    page.run(f"document.querySelector('#{name} button').click()")
    page.wait(f"document.querySelector('#{name} button').getAttribute('aria-pressed') === 'true'")
    if falls:
        page.wait("flying.sides[1].falls === 1")
    else:
        time.sleep(2.0)
    assert page.run("flying.sides.map(({falls}) => falls)") == [0, falls]


@pytest.mark.extras
def test_too_much_latency_fells(page: Browser) -> None:
    reset_without_wind(page)
    page.run("document.getElementById('late').value = 20")
    page.wait("flying.sides[1].falls > 0")
    page.run("document.getElementById('late').value = 0; document.getElementById('reset').click()")
