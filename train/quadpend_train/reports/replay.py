"""Episodes of a comparison that its page can replay in 3-D: which ones, and what happened in them, in few bytes.

`replay.html` beside this module is the page's part, which reads what `recorded` returns. Of each flight it has samples
at 25 Hz, and the last step, as whole numbers of 16 bits, channel after channel, in base64; times its scale, such a
number is the value. Of a channel whose scale is 0 there are none: it is 0 throughout.
"""

import base64
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from tqdm.auto import tqdm

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.physics.parameters import CONTROL_PERIOD
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.recording import Recording, record_episode
from quadpend_train.policies.loading import load_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports.html_page import Section, embedded, environment, style

EVERY = 4  # steps from sample to sample, from the first step on; whatever remains before the last
# Of a sample: names and how many numbers; m, rad, 1 and N, all vectors in the world frame.
CHANNELS = {"position": 3, "euler": 3, "direction": 3, "force": 3, "bob_force": 3, "estimate": 3, "error": 1}
MISSING, _LARGEST = -32768, 32767  # stands for nan; the largest number
_OTHERS = 2  # policies beside the first


class Choice(NamedTuple):
    """An episode to show.

    Attributes:
        title: why.
        episode: its index, counted from 0.
    """

    title: str
    episode: int


def contenders(comparison: Comparison) -> list[str]:
    """The policies to show: the first, and the best others of the leaderboard, of those that were given by name."""
    first = comparison.policies[0]
    others = [standing.policy for standing in leaderboard(comparison) if standing.policy != first]
    return [name for name in (first, *others) if name in comparison.fingerprints][: 1 + _OTHERS]


def choose(comparison: Comparison, scenario: str, policies: list[str], count: int) -> list[Choice]:
    """The typical episode of a scenario, and then the hardest ones.

    What counts is the mean penalised RMSE of the policies, of a learner the first seed's; among equals, the earlier
    episode comes first. Typical is the median, of an even number the lower one.
    """
    rmse = np.mean([comparison.results[scenario, policy].penalised_rmse[0] for policy in policies], axis=0)
    typical = int(np.argsort(rmse, kind="stable")[(len(rmse) - 1) // 2])
    hardest = [episode for episode in np.argsort(-rmse, kind="stable").tolist() if episode != typical]
    titles = ["hardest", *(f"hardest no. {number}" for number in range(2, len(hardest) + 1))]
    return [Choice("typical", typical), *map(Choice, titles, hardest)][:count]


def recorded(comparison: Comparison, given: Mapping[str, str], count: int) -> dict[str, Any] | None:
    """Fly the chosen episodes again and keep what is to be seen of them.

    Args:
        comparison: whose episodes.
        given: what `load_policies` takes, by the names in the comparison.
        count: episodes of each scenario.

    Returns:
        What the page's part reads, for JSON; None if there is nothing to see.
    """
    names = contenders(comparison) if count else []
    policies = {name: load_policies(given[name]) for name in names}
    choices = {name: choose(comparison, name, names, count) for name in comparison.scenarios if names}
    scenarios: dict[str, list[dict[str, Any]]] = {}
    with tqdm(total=len(names) * sum(map(len, choices.values())), unit="recording", leave=False) as bar:
        for name, chosen in choices.items():
            for title, episode in chosen:
                flown = []
                seed = comparison.seed + episode
                for policy, members in policies.items():
                    flown.append(record_episode(policy, members[0], comparison.scenarios[name], seed))
                    bar.update()
                scenarios.setdefault(name, []).append({"title": title, "seed": seed, **_seen(flown)})
    if not scenarios:
        return None
    return {
        "policies": [_looks(name, seeds, comparison.policies.index(name)) for name, seeds in policies.items()],
        "rate": 1.0 / (EVERY * CONTROL_PERIOD),
        "start": CONTROL_PERIOD,
        "duration": EPISODE_STEPS * CONTROL_PERIOD,
        "missing": MISSING,
        "channels": CHANNELS,
        "scenarios": scenarios,
    }


def section(data: dict[str, Any]) -> Section:
    """The page's part; `data` as from `recorded`."""
    template: Any = environment().get_template("replay.html").module
    return Section("replay", "Replay", Markup(template.content(embedded(data))), Markup(template.style()))


def packed(values: Floats) -> dict[str, Any]:
    """Channels, shape (T, c), as whole numbers and the scale of each channel."""
    missing = np.isnan(values)
    largest = np.where(missing, 0.0, np.abs(values)).max(axis=0)
    scales = np.array([float(f"{most / _LARGEST:.6g}") for most in largest])
    scales[(scales == 0.0) & missing.any(axis=0)] = 1.0
    kept = scales > 0.0
    numbers = np.where(missing[:, kept], MISSING, np.round(values[:, kept] / scales[kept])).astype("<i2")
    return {"scales": scales.tolist(), "samples": base64.b64encode(numbers.T.tobytes()).decode("ascii")}


def sampled(steps: int) -> Integers:
    """Which of an episode's steps are kept, counted from 0."""
    return np.append(np.arange(0, steps - 1, EVERY), steps - 1)


def _seen(flown: list[Recording]) -> dict[str, Any]:
    """One episode: its reference, where the bob belongs at 25 Hz, and how each policy flew it."""
    first = flown[0].snapshots[0]
    times = np.asarray(CONTROL_PERIOD * (sampled(EPISODE_STEPS) + 1.0), np.float64)
    target = first.reference.derivatives(times)[:, 0, :3] + [0.0, 0.0, first.rod_length]
    fell = [recording.fell_at and round(recording.fell_at, 2) for recording in flown]
    flights = [{"fell": at, **packed(_samples(recording))} for at, recording in zip(fell, flown, strict=True)]
    return {"rod_length": first.rod_length, "reference": packed(target), "flights": flights}


def _samples(recording: Recording) -> Floats:
    """What `CHANNELS` says, shape (T, 19)."""
    states = [seen.state for seen in recording.snapshots]
    channels = [
        np.array([state.position for state in states]),
        np.unwrap([state.euler for state in states], axis=0),
        np.array([state.direction for state in states]),
        recording.disturbance[:, :6],
        recording.estimate[:, :3],
        recording.error[:, np.newaxis],
    ]
    return np.concatenate(channels, axis=1)[sampled(len(states))]


def _looks(name: str, seeds: list[Any], place: int) -> dict[str, str]:
    """How the page tells a policy apart: what `style` says of its place in the comparison."""
    colour, dashes = style(place)
    return {"name": _label(name, seeds), "colour": colour, "dashes": dashes}


def _label(name: str, seeds: list[Any]) -> str:
    """A policy's name, and which of its training seeds is shown if it has several."""
    if len(seeds) == 1:
        return name
    card = seeds[0].card if isinstance(seeds[0], MlpPolicy) else {}
    return f"{name}, seed {card['seed']}" if "seed" in card else f"{name}, first seed"
