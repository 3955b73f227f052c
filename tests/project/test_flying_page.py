"""The flying page: its files are those of its sources, it flies as Python does, and a visitor can push."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from docs.tools import flying_page
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_train.export import to_c
from quadpend_train.policies.loading import load_policy
from tests.helpers.browser import Browser, start

FLIGHTS = [(vehicle, k) for vehicle, (_, policies) in flying_page.VEHICLES.items() for k in range(len(policies))]
FORCE, BOB_FORCE = [0.1, -0.15, 0.05], [0.01, 0.015, -0.005]
ERROR = "flying.sides[1].curves.at(-1).points.at(-1)?.[1]"  # mm, the last error of the vehicle B


@pytest.mark.parametrize("vehicle", flying_page.VEHICLES)
def test_the_compiled_file_is_that_of_its_sources(vehicle: str, tmp_path: Path) -> None:
    assert flying_page.compiled_hash(vehicle) == flying_page.write_c(vehicle, tmp_path), "run make flying"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    folder = tmp_path_factory.mktemp("flying")
    (folder / "flying.html").write_text(flying_page.page(), encoding="utf-8")
    assert (folder / "flying.html").stat().st_size < 550_000
    with closing(start(folder / "profile")) as browser:
        browser.call("Emulation.setDeviceMetricsOverride", width=1280, height=620, deviceScaleFactor=1, mobile=False)
        browser.open(folder / "flying.html")
        browser.wait("Boolean(flying.fly)")
        yield browser


def flown_by_python(vehicle: str, policy: int) -> Floats:
    """States of two seconds, shape (200, 18)."""
    name = flying_page.VEHICLES[vehicle][1][policy]
    pilot = to_c.adapt(load_policy(name), name, flying_page.design(vehicle), flying_page.GAIN_STEPS)
    env = flying_page.flown(vehicle, force=FORCE, bob_force=BOB_FORCE).make_vec(1)
    (observation, _), memory, states = env.reset(seed=0), None, []
    for step in range(200):
        action, memory = pilot.predict(observation, memory, np.array([step == 0]))
        observation, *_ = env.step(action)
        states.append(env.unwrapped.world.state[0].copy())  # type: ignore[attr-defined]
    return np.array(states)


@pytest.mark.parametrize(("vehicle", "policy"), FLIGHTS)
def test_a_flight_of_two_seconds_is_that_of_python(page: Browser, vehicle: str, policy: int) -> None:
    """Rounding of actions to single precision makes differences of 1e-16 grow, most in the rates of ADRC."""
    found = np.array(page.run(f"flying.fly('{vehicle}', {policy}, {FORCE + BOB_FORCE}, 200)"))
    exact = flown_by_python(vehicle, policy)
    np.testing.assert_allclose(found[:10], exact[:10], rtol=0.0, atol=1e-9)
    for name in ("position", "euler", "direction"):
        np.testing.assert_allclose(getattr(State(found), name), getattr(State(exact), name), rtol=0.0, atol=1e-5)


def test_the_page_fetches_nothing_and_reports_no_error(page: Browser) -> None:
    assert page.run("performance.getEntriesByType('resource').length") == 0
    assert page.messages() == []


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
