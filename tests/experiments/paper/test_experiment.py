"""The experiment reproduces the paper's statements: all errors converge, and the observers estimate the gusts."""

import numpy as np
import pytest

from experiments.paper import GUSTS, Trajectory, figures_of_merit, simulate_sampled
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
