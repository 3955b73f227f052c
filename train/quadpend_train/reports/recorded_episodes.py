"""Episodes of a comparison that the HTML page can replay in 3-D: their selection and recording.

`templates/replay.html` is the page's section, which reads the data that `record_replay` returns. An episode is stored
as samples at about 25 Hz and the last step.
"""

from typing import Any

import numpy as np
from tqdm.auto import tqdm

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.scenarios import Scenario
from quadpend_gym.viewer.snapshot import PAPER_SHAPE, Shape
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.metrics import cells
from quadpend_train.evaluation.recording import Recording, record_episode
from quadpend_train.reports.html_page import style

SAMPLE_PERIOD = 0.04  # s, rounded to whole control periods
# Channels of a sample and their numbers of components: m, rad, unit vector, N, N, N, m; all vectors in the world frame.
CHANNELS = {"position": 3, "euler": 3, "direction": 3, "force": 3, "bob_force": 3, "estimate": 3, "error": 1}
_DECIMALS = 4  # of the samples
_OTHERS = 2  # policies in the replay, besides the first one


def choose_policies(comparison: Comparison) -> list[str]:
    """Return the first policy and the best others of the ranking."""
    first = comparison.policies[0]
    return [first, *[row.policy for row in comparison.ranking if row.policy != first][:_OTHERS]]


def choose_episodes(comparison: Comparison, scenario: str, policies: list[str], count: int) -> list[tuple[str, int]]:
    """Return titles and indices of the typical episode of a scenario, and then of the hardest ones.

    Episodes are ordered by the mean penalised RMSE of the policies, with the first training seed of each learner. The
    typical episode is the median, or the lower median of an even number. Of equal episodes the earlier comes first.
    """
    values = cells(comparison.table)
    rmse = np.mean([values[scenario, policy]["penalised_rmse"][0] for policy in policies], axis=0)
    typical = int(np.argsort(rmse, kind="stable")[(len(rmse) - 1) // 2])
    hardest = [episode for episode in np.argsort(-rmse, kind="stable").tolist() if episode != typical]
    titles = ["typical", "hardest", *(f"hardest no. {number}" for number in range(2, len(hardest) + 1))]
    return list(zip(titles, [typical, *hardest], strict=False))[:count]


def record_replay(comparison: Comparison, count: int) -> dict[str, Any] | None:
    """Run `count` episodes of each scenario again, and return their recordings as data for JSON, or None if it is 0.

    Of a learner with several training seeds the first is recorded.
    """
    if not count:
        return None
    names = choose_policies(comparison)
    scenarios: dict[str, list[dict[str, Any]]] = {}
    for name, scenario in tqdm(comparison.scenarios.items(), desc="recording", unit="scenario", leave=False):
        for title, episode in choose_episodes(comparison, name, names, count):
            seed = comparison.table.attrs["seed"] + episode
            recordings = [record_episode(policy, comparison.learners[policy][0], scenario, seed) for policy in names]
            scene = {"title": title, "seed": seed, **_episode_data(recordings, scenario)}
            scenarios.setdefault(name, []).append(scene)
    return {
        "policies": [
            {
                "name": name if len(comparison.learners[name]) == 1 else f"{name}, first seed",
                **style(comparison.policies.index(name)),
            }
            for name in names
        ],
        "channels": CHANNELS,
        "scenarios": scenarios,
    }


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
    episodes = [
        {"fell": item.fell_at and round(item.fell_at, 6), "samples": _rounded(_samples(item, period))}
        for item in recordings
    ]
    return {
        "rate": 1.0 / (_sample_interval(period) * period),
        "start": period,
        "duration": scenario.steps * period,
        "rod_length": first.rod_length,
        "side": scenario.task.side,
        "shape": shape_data(first.shape),
        "reference": _rounded(reference),
        "episodes": episodes,
    }


def shape_data(shape: Shape) -> dict[str, Any]:
    """Return the sizes of a vehicle as data for JSON."""
    sizes = {name: np.asarray(size).tolist() for name, size in shape._asdict().items()}
    return {**sizes, "paper": shape is PAPER_SHAPE}


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


def _rounded(values: Floats) -> Any:
    """Return samples as lists, with None for nan."""
    return [[None if np.isnan(x) else round(x, _DECIMALS) for x in row] for row in values.tolist()]
