"""The page replays exactly the compared episodes, those that the documentation states, in a real browser."""

import base64
import json
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.jobs import load_learner
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.recording import Recording, record_episode
from quadpend_train.evaluation.table import cells
from quadpend_train.policies.loading import load_policy
from quadpend_train.reports.html_page import style, write
from quadpend_train.reports.replay import (
    CHANNELS,
    MISSING,
    choose_episodes,
    choose_policies,
    encode,
    record_replay,
    sampled_steps,
)
from tests.helpers.browser import Browser, start
from tests.helpers.policies import synthetic_comparison, synthetic_results

NAMES = {"paper": "adrc-paper", "matched": "adrc-matched"}


def constructed(rmse: dict[str, Any]) -> Comparison:
    """A comparison with the given penalised RMSE (m) in one scenario."""
    return synthetic_comparison(0.5, **{name: [synthetic_results(values)] for name, values in rmse.items()})


def decoded(data: dict[str, Any]) -> Floats:
    """Decode channels as the page does, shape (T, c)."""
    scales = np.array(data["scales"])
    numbers = np.frombuffer(base64.b64decode(data["samples"]), "<i2").reshape(np.count_nonzero(scales), -1).T
    values = np.zeros((len(numbers), len(scales)))
    values[:, scales > 0.0] = np.where(numbers == MISSING, np.nan, numbers * scales[scales > 0.0])
    return values


def policies_of(comparison: Comparison) -> list[str]:
    return choose_policies(comparison, leaderboard(comparison.table))


def replay_of(comparison: Comparison, count: int) -> dict[str, Any]:
    data = record_replay(comparison, leaderboard(comparison.table), count)
    assert data is not None
    return data


@pytest.fixture(scope="module")
def replayed() -> tuple[Comparison, dict[str, Any]]:
    comparison = compare(NAMES, ["windy", "storm"], episodes=4)
    return comparison, replay_of(comparison, 2)


def test_the_replay_contains_the_first_policy_and_the_two_best_others() -> None:
    comparison = constructed({"first": [0.5], "worse": [0.4], "good": [0.2], "best": [0.1]})
    assert policies_of(comparison) == ["first", "best", "good"]
    assert policies_of(constructed({"best": [0.1], "other": [0.2]})) == ["best", "other"]


def test_the_replay_contains_policies_given_as_objects() -> None:
    comparison = compare({"object": ADRC(), "name": "adrc-paper"}, {"calm": Scenario(duration=0.5)}, episodes=1)
    data = replay_of(comparison, 1)
    one, other = data["scenarios"]["calm"][0]["episodes"]
    assert one == other


def test_the_median_episode_comes_first_and_then_the_hardest() -> None:
    comparison = constructed({"a": [0.1, 0.5, 0.2, 0.3, 0.9], "b": [0.1, 0.4, 0.2, 0.8, 0.1]})  # mean: 10 45 20 55 50
    chosen = choose_episodes(comparison, "s0", ["a", "b"], 4)
    assert [choice.episode for choice in chosen] == [1, 3, 4, 2]
    assert [choice.title for choice in chosen] == ["typical", "hardest", "hardest no. 2", "hardest no. 3"]
    assert choose_episodes(comparison, "s0", ["a"], 1) == [("typical", 3)]


def test_the_first_training_seed_of_a_learner_is_shown_and_labelled() -> None:
    comparison = constructed({"a": [[0.1, 0.2, 0.3], [0.3, 0.9, 0.1]]})
    assert [choice.episode for choice in choose_episodes(comparison, "s0", ["a"], 2)] == [1, 2]
    comparison.learners["a"] = load_learner("ppo-gain-scheduling-1,ppo-gain-scheduling-0")
    assert [policy["name"] for policy in replay_of(comparison, 1)["policies"]] == ["a, seed 1"]


def test_policies_have_the_same_style_as_in_the_legend_of_the_page() -> None:
    """The policies have the indices 0, 9 and 7, of which 0 and 7 have the same colour."""
    comparison = constructed({f"p{place}": [{9: 0.1, 7: 0.2}.get(place, 0.9)] for place in range(10)})
    looks = [(policy["colour"], policy["dashes"]) for policy in replay_of(comparison, 1)["policies"]]
    assert looks == [style(0), style(9), style(7)]
    assert style(0)[0] == style(7)[0]
    assert style(0)[1] != style(7)[1]


def test_the_recorded_episode_is_the_compared_episode(replayed: tuple[Comparison, dict[str, Any]]) -> None:
    comparison, data = replayed
    for name, scenes in data["scenarios"].items():
        assert [scene["title"] for scene in scenes] == ["typical", "hardest"]
        for scene in scenes:
            episode = scene["seed"] - comparison.seed
            for policy, run in zip(NAMES, scene["episodes"], strict=True):
                values = cells(comparison.table)[name, policy]
                error, steps = decoded(run)[:, -1], int(values["steps"][0, episode])
                exact = comparison.errors[name, policy][0, episode, sampled_steps(steps, 0.01)]
                np.testing.assert_allclose(error, exact, atol=0.51 * run["scales"][-1] + 1e-7)
                assert run["fell"] == (None if values["survived"][0, episode] else pytest.approx(0.01 * steps))
    assert any(run["fell"] for scene in data["scenarios"]["storm"] for run in scene["episodes"])


def test_samples_equal_the_recorded_numbers_within_rounding(replayed: tuple[Comparison, dict[str, Any]]) -> None:
    scene = replayed[1]["scenarios"]["windy"][0]
    recording: Recording = record_episode("", load_policy("adrc-matched"), SCENARIOS["windy"], scene["seed"])
    steps = sampled_steps(EPISODE_STEPS, CONTROL_PERIOD)
    snapshots, run = [recording.snapshots[step] for step in steps], scene["episodes"][1]
    found = dict(zip(CHANNELS, np.split(decoded(run), np.cumsum([*CHANNELS.values()])[:-1], axis=1), strict=True))
    for name, exact, finest in (
        ("position", [snapshot.state.position for snapshot in snapshots], 2e-4),
        ("euler", [snapshot.state.euler for snapshot in snapshots], 1e-4),
        ("direction", [snapshot.state.direction for snapshot in snapshots], 3e-5),
        ("force", [snapshot.disturbance[:3] for snapshot in snapshots], 1e-4),
        ("bob_force", [snapshot.disturbance[3:6] for snapshot in snapshots], 1e-4),
        ("estimate", recording.estimate[steps, :3], 1e-4),
        ("error", [[snapshot.error] for snapshot in snapshots], 1e-4),
    ):
        np.testing.assert_allclose(found[name], exact, atol=finest, err_msg=name)
    times = np.minimum(scene["start"] + np.arange(len(snapshots)) / scene["rate"], scene["duration"])
    np.testing.assert_allclose(times, [snapshot.time for snapshot in snapshots])
    bob = snapshots[-1].reference.derivatives(times[-1])[0, :3] + [0.0, 0.0, scene["rod_length"]]
    np.testing.assert_allclose(decoded(scene["reference"])[-1], bob, atol=1e-4)
    assert len(json.dumps(run)) < 12_000


def test_missing_values_differ_from_zero() -> None:
    values = np.array([[0.0, np.nan, -2.0, np.nan], [0.0, np.nan, np.nan, 0.0], [0.0, np.nan, 1.0, 0.0]])
    data = encode(values)
    np.testing.assert_allclose(decoded(data), values, atol=1e-4)
    assert data["scales"][0] == 0.0, "a channel of zeros is not stored"
    assert len(base64.b64decode(data["samples"])) == 3 * 3 * 2


@pytest.fixture(scope="module")
def page(replayed: tuple[Comparison, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    folder = tmp_path_factory.mktemp("browser")
    write(replayed[0], leaderboard(replayed[0].table), folder / "report.html", replayed[1])
    with closing(start(folder / "profile")) as browser:
        browser.open(folder / "report.html")
        yield browser


PICTURE = "document.getElementById('replay-view').toDataURL()"
CURVES = "document.getElementById('replay-errors').toDataURL()"


def choice(name: str, index: int) -> str:
    """Script that selects an option as a user does."""
    select = f"document.getElementById('replay-{name}')"
    return f"{select}.selectedIndex = {index}; {select}.dispatchEvent(new Event('change'))"


def key(name: str, shift: bool = False) -> str:
    event = f"new KeyboardEvent('keydown', {{key: '{name}', shiftKey: {str(shift).lower()}}})"
    return f"document.getElementById('replay-view').dispatchEvent({event})"


def pixels(page: Browser, colour: str, canvas: str = "view") -> Floats:
    """Horizontal positions of the pixels of a colour, as shares of the width, shape (n,)."""
    return np.array(page.find_colour(f"replay-{canvas}", colour))


def shown(page: Browser, row: str) -> list[str]:
    cells = f"[...document.getElementById('replay-{row}').closest('tr').cells].slice(1).map(cell => cell.textContent)"
    return list(page.run(cells))


def assert_shown(page: Browser, sample: Floats) -> None:
    """Check that the table shows the numbers of a sample for policy A."""
    _, direction, force, _, estimate, error = np.split(sample, [6, 9, 12, 15, 18])
    tilt = np.degrees(np.arccos(direction[2] / np.linalg.norm(direction)))
    exact = [1000.0 * error[0], tilt, np.linalg.norm(force), np.linalg.norm(estimate)]
    for cell, value, finest in zip(shown(page, "one"), exact, (0.5, 0.05, 0.005, 0.005), strict=True):
        assert float(cell) == pytest.approx(value, abs=1.01 * finest)


def test_the_page_opens_without_messages_and_does_not_play(page: Browser) -> None:
    assert page.run("document.readyState") == "complete"
    assert [page.run("replay.time"), page.run("replay.playing")] == [0.0, False]
    assert page.run("document.getElementById('replay-tracked').textContent") == "reference of the bob"
    drawn = "(() => { const c = document.getElementById('replay-view'); return new Set(c.getContext('2d')"
    assert page.run(f"{drawn}.getImageData(0, 0, c.width, c.height).data).size; }})()") > 50
    assert page.messages() == []


def test_play_advances_time_and_pause_stops_it(page: Browser) -> None:
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


def test_the_table_shows_the_recorded_numbers(page: Browser, replayed: tuple[Comparison, dict[str, Any]]) -> None:
    """The times are that of a sample and the middle between two samples."""
    samples = decoded(replayed[1]["scenarios"]["windy"][0]["episodes"][0])
    for at in (100.0, 100.5):
        page.run(f"replay.seek({0.01 + 0.04 * at})")
        assert_shown(page, (samples[int(at)] + samples[int(np.ceil(at))]) / 2.0)


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


def test_the_time_of_a_fall_is_shown(page: Browser, replayed: tuple[Comparison, dict[str, Any]]) -> None:
    fell = replayed[1]["scenarios"]["storm"][1]["episodes"][0]["fell"]
    page.run(choice("scenario", 1) + ";" + choice("episode", 1))
    heading = page.run("document.getElementById('replay-one').closest('tr').cells[0].textContent")
    assert f"fell at {fell:.1f} s" in heading
    samples = decoded(replayed[1]["scenarios"]["storm"][1]["episodes"][0])
    last = CONTROL_PERIOD * (sampled_steps(round(fell / CONTROL_PERIOD), CONTROL_PERIOD)[-2:] + 1)
    for at, sample in ((last.mean(), samples[-2:].mean(axis=0)), (fell, samples[-1]), (10.0, samples[-1])):
        page.run(f"replay.seek({at})")
        assert_shown(page, sample)
    page.run(choice("scenario", 0))


def test_policies_have_the_colours_of_the_legend(page: Browser) -> None:
    page.run("replay.seek(2)")
    lines = "document.querySelectorAll('[data-toggle-policy] line, #replay th line')"
    strokes = page.run(f"[...{lines}].map(line => getComputedStyle(line).stroke)")
    assert strokes[:2] == strokes[2:] == ["rgb(0, 114, 178)", "rgb(213, 94, 0)"]
    for colour in ("#0072B2", "#D55E00"):
        assert min(len(pixels(page, colour, canvas)) for canvas in ("view", "errors")) > 30


def test_the_view_rotates_and_zooms_and_the_page_still_scrolls(page: Browser) -> None:
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


RECORD = """(() => {
    const pen = CanvasRenderingContext2D.prototype, {fillText, stroke, lineTo} = pen;
    window.labels = [], window.plumb = []; let end;
    pen.lineTo = function (x, y) { end = y / this.canvas.clientHeight; lineTo.call(this, x, y); };
    pen.stroke = function () { if (this.getLineDash().join() === "4,5") plumb.push(end); stroke.call(this); };
    pen.fillText = function (text, x, y) {
        const width = this.measureText(text).width, left = x - {left: 0, center: 0.5, right: 1}[this.textAlign] * width;
        if (this.canvas.id === "replay-errors") labels.push([text, left, left + width, y, this.canvas.clientWidth]);
        fillText.call(this, text, x, y);
    };
    replay.seek(0); Object.assign(pen, {fillText, stroke, lineTo});  // the page draws again when its size changes
})()"""


@pytest.mark.parametrize(("duration", "last"), [(0.5, "0.5 s"), (10.0, "10 s"), (60.0, "60 s")])
def test_labels_of_the_error_curves_do_not_overlap_and_shadows_are_in_the_picture(
    duration: float, last: str, page: Browser, replayed: tuple[Comparison, dict[str, Any]], tmp_path: Path
) -> None:
    """Both policies are the same, so their curves end at the same point."""
    data = json.loads(json.dumps(replayed[1]))
    for scene in (scene for scenes in data["scenarios"].values() for scene in scenes):
        scene |= {"duration": duration, "start": duration / 1000.0, "rate": 250.0 / duration}
    write(replayed[0], leaderboard(replayed[0].table), tmp_path / "page.html", data)
    page.call("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=False)
    page.open(tmp_path / "page.html")
    page.run(choice("two", 0) + ";" + RECORD)
    labels = page.run("labels")
    assert {"A", "B", "0 s", last} <= {label[0] for label in labels}
    for i, (_, left, right, y, width) in enumerate(labels):
        assert 0.0 <= left < right <= width
        assert all(right < other[1] or other[2] < left or abs(y - other[3]) >= 12.0 for other in labels[:i])
    assert 0.6 < max(page.run("plumb")) < 0.97
