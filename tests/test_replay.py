"""The page replays the very episodes that were compared, chosen as it says, and does so in a real browser."""

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_gym.arrays import Floats
from tests.policy_helpers import planted
from train.cli import main
from train.evaluate import Comparison, compare
from train.policies import load_policy
from train.recording import Recording, record
from train.replay import CHANNELS, EVERY, MISSING, choose, contenders, packed, recorded, section
from train.scenarios import SCENARIOS

NAMES = {"paper": "adrc-paper", "matched": "adrc-matched"}


def constructed(rmse: dict[str, Any], given: tuple[str, ...] | None = None) -> Comparison:
    """Policies with these values (m) in the only scenario, all or some of them given by name."""
    flights = {("calm", name): planted(values) for name, values in rmse.items()}
    known: dict[str, list[str]] = {name: [] for name in (rmse if given is None else given)}
    scenarios, episodes = {"calm": SCENARIOS["calm"]}, flights["calm", next(iter(rmse))].rmse.shape[1]
    return Comparison(tuple(rmse), scenarios, episodes, 0, flights, known)


def unpacked(data: dict[str, Any]) -> Floats:
    """What the page makes of a recording, shape (T, c)."""
    numbers = np.frombuffer(base64.b64decode(data["samples"]), "<i2").reshape(len(data["scales"]), -1).T
    return np.where(numbers == MISSING, np.nan, numbers * np.array(data["scales"]))


@pytest.fixture(scope="module")
def flown() -> tuple[Comparison, dict[str, Any]]:
    comparison = compare(NAMES, ["windy", "storm"], episodes=4)
    data = recorded(comparison, NAMES, 2)
    assert data is not None
    return comparison, data


def test_shown_are_the_first_policy_and_the_two_best_others() -> None:
    comparison = constructed({"first": [0.5], "worse": [0.4], "good": [0.2], "best": [0.1]})
    assert contenders(comparison) == ["first", "best", "good"]
    assert contenders(constructed({"best": [0.1], "other": [0.2]})) == ["best", "other"]


def test_only_policies_given_by_name_are_shown() -> None:
    assert contenders(constructed({"first": [0.5], "good": [0.2], "best": [0.1]}, ("good",))) == ["good"]
    assert recorded(constructed({"mine": [0.5]}, ()), {}, 2) is None


def test_the_typical_episode_is_the_median_and_then_come_the_hardest() -> None:
    comparison = constructed({"a": [0.1, 0.5, 0.2, 0.3, 0.9], "b": [0.1, 0.4, 0.2, 0.8, 0.1]})  # mean: 10 45 20 55 50
    chosen = choose(comparison, "calm", ["a", "b"], 4)
    assert [choice.episode for choice in chosen] == [1, 3, 4, 2]
    assert [choice.title for choice in chosen] == ["typical", "hardest", "hardest no. 2", "hardest no. 3"]
    assert choose(comparison, "calm", ["a"], 1) == [("typical", 3)]


def test_among_equals_the_first_is_chosen_and_no_episode_twice() -> None:
    fallen = constructed({"a": [1.0, 1.0, 1.0, 1.0]})
    assert choose(fallen, "calm", ["a"], 9) == [
        ("typical", 1),
        ("hardest", 0),
        ("hardest no. 2", 2),
        ("hardest no. 3", 3),
    ]
    assert choose(constructed({"a": [0.1]}), "calm", ["a"], 2) == [("typical", 0)]


def test_of_a_learner_the_first_seed_counts_and_the_label_says_so() -> None:
    comparison = constructed({"a": [[0.1, 0.2, 0.3], [0.3, 0.9, 0.1]]})
    assert [choice.episode for choice in choose(comparison, "calm", ["a"], 2)] == [1, 2]
    data = recorded(comparison, {"a": "ppo-pace-1,ppo-pace-0"}, 1)
    assert data is not None
    assert data["policies"] == ["a, seed 1"]


def test_the_recorded_episode_is_the_very_one_that_was_compared(flown: tuple[Comparison, dict[str, Any]]) -> None:
    comparison, data = flown
    for name, scenes in data["scenarios"].items():
        assert [scene["title"] for scene in scenes] == ["typical", "hardest"]
        for scene in scenes:
            episode = scene["seed"] - comparison.seed
            for policy, flight in zip(NAMES, scene["flights"], strict=True):
                flights = comparison.flights[name, policy]
                error, steps = unpacked(flight)[:, -1], flights.steps[0, episode]
                assert len(error) == len(range(0, steps - 1, EVERY))
                exact = flights.error[0, episode, : steps - 1 : EVERY]
                np.testing.assert_allclose(error, exact, atol=0.51 * flight["scales"][-1] + 1e-7)
                assert flight["fell"] == (None if flights.survived[0, episode] else pytest.approx(0.01 * steps))
    assert any(flight["fell"] for scene in data["scenarios"]["storm"] for flight in scene["flights"])


def test_samples_are_the_recorded_numbers_within_their_rounding(flown: tuple[Comparison, dict[str, Any]]) -> None:
    scene = flown[1]["scenarios"]["windy"][0]
    recording: Recording = record("", load_policy("adrc-matched"), SCENARIOS["windy"], scene["seed"])
    seen, flight = recording.snapshots[::EVERY], scene["flights"][1]
    found = dict(zip(CHANNELS, np.split(unpacked(flight), np.cumsum([*CHANNELS.values()])[:-1], axis=1), strict=True))
    for name, exact, finest in (
        ("position", [one.state.position for one in seen], 2e-4),
        ("euler", [one.state.euler for one in seen], 1e-4),
        ("direction", [one.state.direction for one in seen], 3e-5),
        ("force", [one.disturbance[:3] for one in seen], 1e-4),
        ("bob_force", [one.disturbance[3:6] for one in seen], 1e-4),
        ("estimate", recording.estimate[::EVERY, :3], 1e-4),
        ("error", [[one.error] for one in seen], 1e-4),
    ):
        np.testing.assert_allclose(found[name], exact, atol=finest, err_msg=name)
    times = flown[1]["start"] + np.arange(len(seen)) / flown[1]["rate"]
    np.testing.assert_allclose(times, [one.time for one in seen])
    bob = seen[-1].reference.derivatives(times[-1])[0, :3] + [0.0, 0.0, scene["rod_length"]]
    np.testing.assert_allclose(unpacked(scene["reference"])[len(seen) - 1], bob, atol=1e-4)
    assert len(json.dumps(flight)) < 15_000


def test_what_is_not_known_is_told_apart_from_zero() -> None:
    values = np.array([[0.0, np.nan, -2.0], [0.0, np.nan, np.nan], [0.0, np.nan, 1.0]])
    np.testing.assert_allclose(unpacked(packed(values)), values, atol=1e-4)


def test_the_command_takes_the_number_of_episodes(tmp_path: Path) -> None:
    command = ["evaluate", "--policies", "adrc-paper", "--scenarios", "calm", "--episodes", "2", "--out", str(tmp_path)]
    command += ["--store", str(tmp_path / "store")]
    for count in (0, 1):
        main([*command, "--replay", str(count)])
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert page.count("typical") == page.count('<section id="replay">') == count


class Browser:
    """Headless Chromium, spoken to through pipes in the DevTools protocol."""

    def __init__(self, program: str, folder: Path) -> None:
        command, self._commands = os.pipe()
        self._answers, answer = os.pipe()
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (command, answer)]
        arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"]
        arguments += ["--remote-debugging-pipe", f"--user-data-dir={folder}", "about:blank"]
        actions: list[Any] = [(os.POSIX_SPAWN_DUP2, end, number) for end, number in zip(ends, (3, 4), strict=True)]
        actions += [(os.POSIX_SPAWN_OPEN, 1, str(folder / "log"), os.O_WRONLY | os.O_CREAT, 0o600)]
        actions += [(os.POSIX_SPAWN_DUP2, 1, 2)]
        folder.mkdir()
        self.process = os.posix_spawn(program, [program, *arguments], os.environ, file_actions=actions, setpgroup=0)
        for end in (command, answer, *ends):
            os.close(end)
        self._count, self._received, self._session = 0, b"", {}
        self.events: list[dict[str, Any]] = []
        (page,) = [one for one in self.call("Target.getTargets")["targetInfos"] if one["type"] == "page"]
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters, **self._session}
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while (received := self._receive()).get("id") != self._count:
            self.events.append(received)
        assert "error" not in received, received
        return dict(received["result"])

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._received:
            assert select.select([self._answers], [], [], 20.0)[0], "the browser does not answer"
            got = os.read(self._answers, 1 << 16)
            assert got, "the browser has ended"
            self._received += got
        message, _, self._received = self._received.partition(b"\0")
        return dict(json.loads(message))

    def open(self, path: Path) -> None:
        self.call("Page.navigate", url=path.as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._receive())

    def run(self, script: str) -> Any:
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        end = time.monotonic() + 10.0
        while not self.run(condition):
            assert time.monotonic() < end, f"never: {condition}"
            time.sleep(0.02)

    def complaints(self) -> list[Any]:
        wrong = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")
        return [event["params"] for event in self.events if event.get("method") in wrong]

    def close(self) -> None:
        os.killpg(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        os.close(self._commands)
        os.close(self._answers)


@pytest.fixture(scope="module")
def page(flown: tuple[Comparison, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    from train.html_report import write

    programs = [shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")]
    program = next(filter(None, programs), None)
    if program is None:
        pytest.skip("there is no Chromium here to open the page in")
    folder = tmp_path_factory.mktemp("browser")
    write(flown[0], None, folder / "report.html", [section(flown[1])])
    browser = Browser(program, folder / "profile")
    try:
        browser.open(folder / "report.html")
        yield browser
    finally:
        browser.close()


PICTURE = "document.getElementById('replay-view').toDataURL()"
CURVES = "document.getElementById('replay-errors').toDataURL()"


def choice(name: str, index: int) -> str:
    """Script that chooses as a hand does."""
    select = f"document.getElementById('replay-{name}')"
    return f"{select}.selectedIndex = {index}; {select}.dispatchEvent(new Event('change'))"


def key(name: str, shift: bool = False) -> str:
    event = f"new KeyboardEvent('keydown', {{key: '{name}', shiftKey: {str(shift).lower()}}})"
    return f"document.getElementById('replay-view').dispatchEvent({event})"


def shown(page: Browser, row: str) -> list[str]:
    cells = f"[...document.getElementById('replay-{row}').closest('tr').cells].slice(1).map(cell => cell.textContent)"
    return list(page.run(cells))


def test_the_page_opens_quietly_and_does_not_play_by_itself(page: Browser) -> None:
    assert page.run("document.readyState") == "complete"
    assert page.run("replay.time") == 0.0
    assert page.run("replay.playing") is False
    drawn = "(() => { const c = document.getElementById('replay-view'); return new Set(c.getContext('2d')"
    assert page.run(f"{drawn}.getImageData(0, 0, c.width, c.height).data).size; }})()") > 50
    assert page.complaints() == []


def test_play_moves_on_and_pause_stops(page: Browser) -> None:
    page.run("replay.seek(1)")
    page.run("document.getElementById('replay-play').click()")
    page.wait("replay.time > 1.2")
    page.run(key(" "))
    assert page.run("replay.playing") is False
    time_then = page.run("replay.time")
    time.sleep(0.1)
    assert page.run("replay.time") == time_then
    page.run("replay.seek(9.9); replay.play()")
    page.wait("!replay.playing")
    assert page.run("replay.time") == 10.0


def test_scrubbing_moves_the_picture_and_back_again(page: Browser) -> None:
    page.run("replay.seek(2)")
    first, curves = page.run(PICTURE), page.run(CURVES)
    scrub = "document.getElementById('replay-scrub')"
    page.run(f"{scrub}.value = 4; {scrub}.dispatchEvent(new Event('input'))")
    assert page.run("replay.time") == 4.0
    assert page.run(PICTURE) != first
    assert page.run(CURVES) != curves
    page.run("replay.seek(2)")
    assert page.run(PICTURE) == first


def test_numbers_beside_the_picture_are_those_of_the_flight(
    page: Browser, flown: tuple[Comparison, dict[str, Any]]
) -> None:
    """At a sample and half-way between two."""
    samples = unpacked(flown[1]["scenarios"]["windy"][0]["flights"][0])
    for at in (100.0, 100.5):
        page.run(f"replay.seek({0.01 + 0.04 * at})")
        sample = (samples[int(at)] + samples[int(np.ceil(at))]) / 2.0
        _, direction, force, _, estimate, error = np.split(sample, [6, 9, 12, 15, 18])
        tilt = np.degrees(np.arccos(direction[2] / np.linalg.norm(direction)))
        exact = [1000.0 * error[0], tilt, np.linalg.norm(force), np.linalg.norm(estimate)]
        for cell, value, finest in zip(shown(page, "one"), exact, (0.5, 0.05, 0.005, 0.005), strict=True):
            assert float(cell) == pytest.approx(value, abs=1.01 * finest)


def test_scenarios_episodes_and_policies_can_be_switched(page: Browser) -> None:
    page.run("replay.seek(3)")
    pictures = [page.run(PICTURE)]
    for name, index in (("scenario", 1), ("episode", 1), ("two", 2), ("one", 1)):
        page.run(choice(name, index))
        pictures.append(page.run(PICTURE))
    assert len(set(pictures)) == len(pictures)
    assert page.run("document.getElementById('replay-two').selectedOptions[0].text") == "none"
    assert shown(page, "two") == ["", "", "", ""]
    page.run(choice("scenario", 0) + ";" + choice("one", 0) + ";" + choice("two", 1))
    assert page.run(PICTURE) == pictures[0]


def test_one_who_fell_is_told(page: Browser, flown: tuple[Comparison, dict[str, Any]]) -> None:
    fell = flown[1]["scenarios"]["storm"][1]["flights"][0]["fell"]
    page.run(choice("scenario", 1) + ";" + choice("episode", 1))
    told = page.run("document.getElementById('replay-one').closest('tr').cells[0].textContent")
    assert f"fell at {fell:.1f} s" in told
    page.run(choice("scenario", 0))


def test_the_view_turns_and_zooms_but_lets_the_page_scroll(page: Browser) -> None:
    page.run("replay.seek(2)")
    pictures = [page.run(PICTURE)]
    view = "document.getElementById('replay-view')"
    for script in (key("ArrowLeft", shift=True), key("+")):
        page.run(script)
        pictures.append(page.run(PICTURE))
    wheel = f"{view}.dispatchEvent(new WheelEvent('wheel', {{deltaY: 100, cancelable: true, ctrlKey: %s}}))"
    assert page.run(wheel % "false") is True
    assert page.run(PICTURE) == pictures[-1]
    assert page.run(wheel % "true") is False
    pictures.append(page.run(PICTURE))
    page.run(f"{view}.scrollIntoView({{behavior: 'instant', block: 'center'}})")
    box = page.run(f"(({{x, y}}) => [x, y])({view}.getBoundingClientRect())")
    for kind, across in (("mousePressed", 100), ("mouseMoved", 160), ("mouseReleased", 160)):
        place = {"x": box[0] + across, "y": box[1] + 100, "button": "left", "buttons": 1, "clickCount": 1}
        page.call("Input.dispatchMouseEvent", type=kind, **place)
    pictures.append(page.run(PICTURE))
    assert len(set(pictures)) == len(pictures)
    page.run(f"{view}.dispatchEvent(new MouseEvent('dblclick'))")
    assert page.run(PICTURE) == pictures[0]


def test_it_is_sharp_follows_the_theme_and_prints_its_beginning(page: Browser) -> None:
    page.run("replay.seek(2)")
    light = page.run(PICTURE)
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    page.wait(f"{PICTURE} !== {json.dumps(light)}")
    page.run("window.dispatchEvent(new Event('beforeprint'))")
    assert page.run("replay.time") == 0.0
    page.run("window.dispatchEvent(new Event('afterprint'))")
    page.call("Emulation.setEmulatedMedia", features=[])
    page.call("Emulation.setDeviceMetricsOverride", width=400, height=800, deviceScaleFactor=2, mobile=True)
    page.wait("(view => view.width === 2 * view.clientWidth)(document.getElementById('replay-view'))")
    assert page.run("document.documentElement.scrollWidth") <= 400
    assert page.complaints() == []
