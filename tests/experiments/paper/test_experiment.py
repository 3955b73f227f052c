"""The experiment reproduces the paper's statements: all errors converge, and the observers estimate the gusts."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import paper
from experiments.paper_continuous import ContinuousLoop, Trajectory
from experiments.paper_experiment import GUSTS, REFERENCE, figures_of_merit, gusts, simulate_sampled, start_state
from quadpend_baselines import controller
from quadpend_gym import State


@pytest.fixture(scope="module")
def at_100_hz() -> Trajectory:
    return simulate_sampled(0.01)


def test_all_errors_converge_in_calm_air_and_the_pendulum_is_upright(at_100_hz: Trajectory) -> None:
    calm = (at_100_hz.time > 6.0) & (at_100_hz.time < GUSTS.onset)
    assert np.all(np.abs(at_100_hz.error[calm]).max(axis=0) < [1e-4, 1e-4, 1e-6, 1e-6])
    assert State(at_100_hz.state).alpha[calm].max() < 0.03  # due to the centripetal acceleration of the circle


def test_estimates_follow_the_injected_gusts_in_all_four_channels(at_100_hz: Trajectory) -> None:
    merit = figures_of_merit(at_100_hz)
    assert min(merit["correlation_of_estimates"].values()) >= 0.99
    assert merit["convergence_time"]["0.01"]["F_x"] < 2.0
    assert merit["convergence_time"]["0.0001"]["z"] < 2.0


def test_sampled_control_approaches_continuous_time() -> None:
    duration, step = 0.5, 4e-4
    times = 0.5 * step * np.arange(2 * round(duration / step) + 1)
    continuous = ContinuousLoop(controller("adrc-paper")).simulate(start_state(), REFERENCE, gusts(times), step, 25)
    differences = []
    for period in (1e-2, 1e-3):
        sampled = simulate_sampled(period, duration)
        differences.append(np.abs(sampled.error - continuous.error)[:, :3].max())
    assert differences[0] < 0.02
    assert differences[1] < differences[0] / 4


def test_the_script_writes_all_figures_and_the_figures_of_merit(
    at_100_hz: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").mkdir()
    monkeypatch.setattr(paper, "DOCS", tmp_path)
    monkeypatch.setattr(paper, "run", lambda: dict.fromkeys(("continuous", "1 kHz", "100 Hz"), at_100_hz))
    monkeypatch.setattr("sys.argv", ["paper"])
    paper.main()
    assert {path.stem for path in (tmp_path / "results/paper").iterdir()} == {*paper.FIGURES, "figure_10"}
    assert json.loads((tmp_path / "paper/merit.json").read_text())["100 Hz"]["rmse_in_gusts"]["z"] < 1e-3
