"""The experiment reproduces the paper's statements: all errors converge, and the observers estimate the gusts."""

from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_baselines.paper import experiment
from quadpend_baselines.paper.continuous import ContinuousLoop, Trajectory
from quadpend_baselines.paper.experiment import GUSTS, REFERENCE, gusts, simulate_sampled, start_state
from quadpend_baselines.paper.figures import FIGURES
from quadpend_gym import State
from quadpend_train.cli.main import main


@pytest.fixture(scope="module")
def at_100_hz() -> Trajectory:
    return simulate_sampled("paper", 0.01)


def test_all_errors_converge_in_calm_air_and_the_pendulum_is_upright(at_100_hz: Trajectory) -> None:
    calm = (at_100_hz.time > 6.0) & (at_100_hz.time < GUSTS.onset)
    assert np.all(np.abs(at_100_hz.error[calm]).max(axis=0) < [1e-4, 1e-4, 1e-6, 1e-6])
    assert State(at_100_hz.state).alpha[calm].max() < 0.03  # due to the centripetal acceleration of the circle


def test_estimates_follow_the_injected_gusts_in_all_four_channels(at_100_hz: Trajectory) -> None:
    merit = experiment.figures_of_merit(at_100_hz)
    assert min(merit["correlation_of_estimates"].values()) >= 0.99
    assert merit["convergence_time"]["0.01"]["F_x"] < 2.0
    assert merit["convergence_time"]["0.0001"]["z"] < 2.0


def test_sampled_control_approaches_continuous_time() -> None:
    duration, step = 0.5, 4e-4
    times = 0.5 * step * np.arange(2 * round(duration / step) + 1)
    continuous = ContinuousLoop(ADRC("paper")).simulate(start_state(), REFERENCE, gusts(times), step, 25)
    differences = []
    for period in (1e-2, 1e-3):
        sampled = simulate_sampled("paper", period, duration)
        differences.append(np.abs(sampled.error - continuous.error)[:, :3].max())
    assert differences[0] < 0.02
    assert differences[1] < differences[0] / 4


def test_paper_command_writes_all_figures_and_the_figures_of_merit(
    at_100_hz: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = dict.fromkeys(("continuous", "1 kHz", "100 Hz"), at_100_hz)
    monkeypatch.setattr(experiment, "run", lambda gains: result)
    main(["paper", "--out", str(tmp_path)])
    names = {path.name for path in tmp_path.iterdir()}
    figures = [*FIGURES, "figure_10"]
    assert names == {"merit.json", *(f"{name}.png" for name in figures), *(f"{name}.svg" for name in figures)}
