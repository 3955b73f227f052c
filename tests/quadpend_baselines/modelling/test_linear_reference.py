"""The linear reference: LQG reaches it, other controllers do not, and it says to what it does not apply."""

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_lyapunov

from quadpend_baselines import controller
from quadpend_baselines.modelling.linear_loop import linear_policy
from quadpend_baselines.modelling.linear_reference import _design, linear_problem, linear_reference
from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_gym.sensors import Delay, Noise
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import Dryden, OrnsteinUhlenbeck

HOVER = Scenario(
    task=TASKS["hover"],
    vehicle=VEHICLES["hummingbird"],
    interface="body_rates",
    latency=0.02,
    wind=OrnsteinUhlenbeck(force=0.12),
    sensors=Noise(position=0.0005, euler=0.001, direction=0.0006),
    observation=OUTPUT_FEEDBACK,
)


def stationary_error(scenario: Scenario, policy: Any) -> float:
    """Return the RMS error of a linear policy, from the measurements to the actions, in the linear model, m."""
    A, B, N, C, error, V = linear_problem(scenario)
    transition = np.block([[A + B @ policy.D @ C, B @ policy.C], [policy.B @ C, policy.A]])
    assert np.abs(np.linalg.eigvals(transition)).max() < 1.0
    noise = np.block([[N, B @ policy.D], [np.zeros((policy.nstates, N.shape[1])), policy.B]])
    covariance = solve_discrete_lyapunov(transition, noise @ block_diag(np.eye(N.shape[1]), V) @ noise.T)
    return float(np.sqrt(np.trace(error @ covariance[: len(A), : len(A)] @ error.T)))


@pytest.mark.parametrize(
    "scenario", [HOVER, replace(HOVER, wind=Dryden(3.0)), replace(HOVER, sensors=[*HOVER.sensors, Delay(1)])]
)
def test_lqg_reaches_the_reference_in_the_linear_model(scenario: Scenario) -> None:
    problem = linear_problem(scenario)
    *_, K, F = _design(problem)
    closed, corrected = problem.A - problem.B @ F, np.eye(len(problem.A)) - K @ problem.C
    policy = control.ss(closed @ corrected, closed @ K, -F @ corrected, -F @ K, scenario.period)
    assert stationary_error(scenario, policy) == pytest.approx(linear_reference(scenario), rel=0.01)


def test_less_noise_or_delay_changes_the_reference_as_it_must() -> None:
    reference = linear_reference(HOVER)
    assert linear_reference(replace(HOVER, latency=0.0)) < reference
    assert linear_reference(replace(HOVER, sensors=())) < reference
    doubled = replace(
        HOVER, wind=OrnsteinUhlenbeck(force=0.24), sensors=Noise(position=0.001, euler=0.002, direction=0.0012)
    )
    assert linear_reference(doubled) == pytest.approx(2.0 * reference, rel=1e-3)


@pytest.mark.parametrize("name", ["lqr", "flatness", "lqg"])
def test_no_controller_is_better_than_the_reference(name: str) -> None:
    policy = linear_policy(controller(name).adapt(HOVER), HOVER)
    assert stationary_error(HOVER, policy) > linear_reference(HOVER)


@pytest.mark.parametrize(
    "name", ["calm", "steady", "gusts", "sinusoid_slow", "uncertain", "fast", "training_noisy", "as_flown"]
)
def test_it_refuses_scenarios_to_which_it_does_not_apply(name: str) -> None:
    """`training_noisy` has motion, and as_flown lost packets and biases."""
    scenario = find_scenario(name if name == "as_flown" else f"hummingbird_{name}")
    with pytest.raises(ValueError, match="the linear reference applies to hover"):
        linear_reference(scenario)
