"""The page replays exactly the compared episodes, those that the documentation states, in a real browser."""

import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.metrics import cells
from quadpend_train.policies.loading import load_policies
from quadpend_train.reports.html_page import write
from quadpend_train.reports.recorded_episodes import choose_episodes, choose_policies, record_replay, sampled_steps
from tests.helpers.browser import Browser, start
from tests.helpers.policies import synthetic_comparison, synthetic_results

NAMES = {"paper": "adrc-paper", "matched": "adrc-matched"}


def constructed(rmse: dict[str, Any]) -> Comparison:
    """A comparison with the given penalised RMSE (m) in one scenario."""
    return synthetic_comparison(0.5, **{name: [synthetic_results(values)] for name, values in rmse.items()})


def replay_of(comparison: Comparison, count: int) -> dict[str, Any]:
    data = record_replay(comparison, count)
    assert data is not None
    return data


@pytest.fixture(scope="module")
def replayed() -> tuple[Comparison, dict[str, Any]]:
    comparison = compare(NAMES, ["windy", "storm"], episodes=4)
    return comparison, replay_of(comparison, 2)


def test_the_replay_contains_the_first_policy_and_the_two_best_others() -> None:
    comparison = constructed({"first": [0.5], "worse": [0.4], "good": [0.2], "best": [0.1]})
    assert choose_policies(comparison) == ["first", "best", "good"]
    assert choose_policies(constructed({"best": [0.1], "other": [0.2]})) == ["best", "other"]


def test_the_median_episode_comes_first_and_then_the_hardest() -> None:
    comparison = constructed({"a": [0.1, 0.5, 0.2, 0.3, 0.9], "b": [0.1, 0.4, 0.2, 0.8, 0.1]})  # mean: 10 45 20 55 50
    chosen = choose_episodes(comparison, "s0", ["a", "b"], 4)
    assert chosen == [("typical", 1), ("hardest", 3), ("hardest no. 2", 4), ("hardest no. 3", 2)]
    assert choose_episodes(comparison, "s0", ["a"], 1) == [("typical", 3)]


def test_the_first_training_seed_of_a_learner_is_shown_and_labelled() -> None:
    comparison = constructed({"a": [[0.1, 0.2, 0.3], [0.3, 0.9, 0.1]]})
    assert [episode for _, episode in choose_episodes(comparison, "s0", ["a"], 2)] == [1, 2]
    comparison.learners["a"] = load_policies("ppo-alone-0,apg-0")
    assert [policy["name"] for policy in replay_of(comparison, 1)["policies"]] == ["a, first seed"]


def test_the_recorded_episode_is_the_compared_episode(replayed: tuple[Comparison, dict[str, Any]]) -> None:
    comparison, data = replayed
    for name, scenes in data["scenarios"].items():
        assert [scene["title"] for scene in scenes] == ["typical", "hardest"]
        for scene in scenes:
            episode = scene["seed"] - comparison.table.attrs["seed"]
            for policy, run in zip(NAMES, scene["episodes"], strict=True):
                values = cells(comparison.table)[name, policy]
                error, steps = np.array(run["samples"])[:, -1], int(values["steps"][0, episode])
                exact = comparison.errors[name, policy][0, episode, sampled_steps(steps, 0.01)]
                np.testing.assert_allclose(error, exact, atol=0.51e-4)
                assert run["fell"] == (None if values["survived"][0, episode] else pytest.approx(0.01 * steps))
    assert any(run["fell"] for scene in data["scenarios"]["storm"] for run in scene["episodes"])


@pytest.fixture(scope="module")
def page(replayed: tuple[Comparison, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    folder = tmp_path_factory.mktemp("browser")
    write(replayed[0], folder / "report.html", replayed[1])
    with closing(start(folder / "profile")) as browser:
        browser.open(folder / "report.html")
        yield browser


PICTURE = "document.getElementById('replay-view').toDataURL()"


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
    samples = np.array(replayed[1]["scenarios"]["windy"][0]["episodes"][0]["samples"])
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
