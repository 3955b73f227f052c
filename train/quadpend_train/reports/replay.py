"""Episodes of a comparison that the HTML page can replay in 3-D: their selection, recording and storage.

`templates/replay.html` is the page's section, which reads the data that `record_replay` returns. An episode is stored
as samples at about 25 Hz and the last step. Each channel of the samples is an array of 16-bit integers; an integer
times the scale of the channel is the value. The arrays are concatenated and encoded in base64. A channel with the scale
0 is 0 throughout and is not stored.
"""

import base64
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from tqdm.auto import tqdm

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.scenarios import Scenario
from quadpend_gym.viewer.shape import PAPER_SHAPE, Shape
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.leaderboard import LeaderboardRow
from quadpend_train.evaluation.recording import Recording, record_episode
from quadpend_train.evaluation.table import cells
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports.html_page import style

SAMPLE_PERIOD = 0.04  # s, rounded to whole control periods
# Channels of a sample and their numbers of components: m, rad, unit vector, N, N, N, m; all vectors in the world frame.
CHANNELS = {"position": 3, "euler": 3, "direction": 3, "force": 3, "bob_force": 3, "estimate": 3, "error": 1}
MISSING, _LARGEST = -32768, 32767  # the integer that stands for nan, and the largest integer
_DISTANCE, _FARTHER = 2.7, 3.4 / 2.7  # m, of the page's camera, and that of the viewer's camera relative to it
_OTHERS = 2  # policies in the replay, besides the first one


class Choice(NamedTuple):
    """An episode to replay: the reason for the choice, and its index."""

    title: str
    episode: int


def choose_policies(comparison: Comparison, standings: Sequence[LeaderboardRow]) -> list[str]:
    """Return the first policy and the best others of the leaderboard."""
    first = comparison.policies[0]
    others = [row.policy for row in standings if row.policy != first]
    return [first, *others][: 1 + _OTHERS]


def choose_episodes(comparison: Comparison, scenario: str, policies: list[str], count: int) -> list[Choice]:
    """Return the typical episode of a scenario, and then the hardest ones.

    Episodes are ordered by the mean penalised RMSE of the policies, with the first training seed of each learner. The
    typical episode is the median, or the lower median of an even number. Of equal episodes the earlier comes first.
    """
    values = cells(comparison.table)
    rmse = np.mean([values[scenario, policy]["penalised_rmse"][0] for policy in policies], axis=0)
    typical = int(np.argsort(rmse, kind="stable")[(len(rmse) - 1) // 2])
    hardest = [episode for episode in np.argsort(-rmse, kind="stable").tolist() if episode != typical]
    titles = ["hardest", *(f"hardest no. {number}" for number in range(2, len(hardest) + 1))]
    return [Choice("typical", typical), *map(Choice, titles, hardest)][:count]


def record_replay(comparison: Comparison, standings: Sequence[LeaderboardRow], count: int) -> dict[str, Any] | None:
    """Run `count` episodes of each scenario again, and return their recordings as data for JSON, or None if it is 0.

    Of a learner with several training seeds the first is recorded.
    """
    if not count:
        return None
    names = choose_policies(comparison, standings)
    chosen = {name: comparison.learners[name] for name in names}
    choices = {name: choose_episodes(comparison, name, names, count) for name in comparison.scenarios}
    scenarios: dict[str, list[dict[str, Any]]] = {}
    with tqdm(total=len(names) * sum(map(len, choices.values())), unit="recording", leave=False) as bar:
        for name, episodes in choices.items():
            scenario = comparison.scenarios[name]
            for title, episode in episodes:
                recordings, seed = [], comparison.seed + episode
                for policy, seeds in chosen.items():
                    recordings.append(record_episode(policy, seeds[0], scenario, seed))
                    bar.update()
                data = _episode_data(recordings, scenario)
                scenarios.setdefault(name, []).append({"title": title, "seed": seed, **data})
    return {
        "policies": [
            {
                "name": _label(name, seeds),
                **dict(zip(("colour", "dashes"), style(comparison.policies.index(name)), strict=True)),
            }
            for name, seeds in chosen.items()
        ],
        "missing": MISSING,
        "channels": CHANNELS,
        "scenarios": scenarios,
    }


def encode(values: Floats) -> dict[str, Any]:
    """Encode channels, shape (T, c), as integers in base64, with the scale of each channel."""
    missing = np.isnan(values)
    largest = np.where(missing, 0.0, np.abs(values)).max(axis=0)
    scales = np.array([float(f"{value / _LARGEST:.6g}") for value in largest])
    scales[(scales == 0.0) & missing.any(axis=0)] = 1.0
    stored = scales > 0.0
    integers = np.where(missing[:, stored], MISSING, np.round(values[:, stored] / scales[stored])).astype("<i2")
    return {"scales": scales.tolist(), "samples": base64.b64encode(integers.T.tobytes()).decode("ascii")}


def sampled_steps(steps: int, period: float) -> Integers:
    """Return the indices of the stored steps of an episode, from 0, at a control period in s."""
    return np.append(np.arange(0, steps - 1, _sample_interval(period)), steps - 1)


def _sample_interval(period: float) -> int:
    """Return the number of control steps between two samples."""
    return max(round(SAMPLE_PERIOD / period), 1)


def _episode_data(recordings: list[Recording], scenario: Scenario) -> dict[str, Any]:
    """Return the data of one episode: times, sizes, and samples of the bob's reference and of each policy.

    The times are the sampling rate (Hz), the time of the first sample (s) and the duration of the episode (s).
    """
    first, period = recordings[0].snapshots[0], scenario.simulation.period
    times = np.asarray(period * (sampled_steps(scenario.steps, period) + 1.0), np.float64)
    reference = first.reference.derivatives(times)[:, 0, :3] + [0.0, 0.0, first.reference_arm] + first.shape.pivot
    fell = [recording.fell_at and round(recording.fell_at, 6) for recording in recordings]
    episodes = [
        {"fell": at, **encode(_samples(recording, period))} for at, recording in zip(fell, recordings, strict=True)
    ]
    return {
        "rate": 1.0 / (_sample_interval(period) * period),
        "start": period,
        "duration": scenario.steps * period,
        "rod_length": first.rod_length,
        "side": scenario.task.side,
        "shape": shape_data(first.shape),
        "reference": encode(reference),
        "episodes": episodes,
    }


def shape_data(shape: Shape) -> dict[str, Any]:
    """Return the sizes of the vehicle, with the distances of the page's camera.

    `rise` is the height of the point at which the camera looks above the vehicles, None for the paper's vehicle, and
    `longest` the length of the longest arrow of a force.
    """
    is_paper = shape is PAPER_SHAPE
    distance_scale = shape.distance_scale * (1.0 if is_paper else _FARTHER)
    rise = None if is_paper else shape.lift - 0.22 * _DISTANCE * distance_scale
    data = {**shape._asdict(), "distance_scale": distance_scale, "rise": rise, "longest": shape.distance_scale}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in data.items()}


def _samples(recording: Recording, period: float) -> Floats:
    """Return the samples of all `CHANNELS`, shape (T, 19)."""
    states = [snapshot.state for snapshot in recording.snapshots]
    channels = [
        np.array([state.position for state in states]),
        np.unwrap([state.euler for state in states], axis=0),
        np.array([state.direction for state in states]),
        recording.disturbance[:, :6],
        recording.estimate[:, :3],
        recording.error[:, np.newaxis],
    ]
    return np.concatenate(channels, axis=1)[sampled_steps(len(states), period)]


def _label(name: str, seeds: Sequence[Any]) -> str:
    """Return the name of a policy and, if it has several training seeds, which of them is shown."""
    if len(seeds) == 1:
        return name
    card = seeds[0].card if isinstance(seeds[0], MlpPolicy) else {}
    return f"{name}, seed {card['seed']}" if "seed" in card else f"{name}, first seed"
