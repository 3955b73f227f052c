"""ADRC: tracking, steady offsets, disturbance estimates, and the `predict` protocol."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import CONTROLLERS, Policy, controller
from quadpend_baselines.controllers.adrc import AdrcGains, AdrcLaw
from quadpend_baselines.estimation.observers import LUENBERGER_INPUT, chain, current_gain, input_gain
from quadpend_baselines.gains import ObserverGains, tuning
from quadpend_baselines.policy.rollout import rollout
from quadpend_baselines.registry import controller_of
from quadpend_gym import (
    PAPER,
    Constant,
    OrnsteinUhlenbeck,
    QuadPendulumVectorEnv,
    Reference,
    Simulation,
)
from quadpend_gym.sensors import Noise
from tests.helpers.controllers import run_policy, simulation_of

EPISODES = 30


def predicted_offset(gains: AdrcGains, simulation: Simulation) -> float:
    """Return the steady error per newton of a constant force on the quadrotor (m/N) by linear theory.

    The corrected control law neglects w = −g d/(M l) in F⁽⁴⁾ = F₅ + w, both in its feedback and in the input of the
    Luenberger stage, whose error settles at x̃ = (I − L C)(Φ x̃ + Γ w). The offset is (k₄ w + k₀ x̃₁ + … + k₃ x̃₄)/k₀.
    """
    p, period = simulation.parameters, simulation.period
    w = p.gravity / (p.quadrotor_mass * p.rod_length)
    correct = np.eye(4) - np.outer(current_gain(gains.luenberger, period), [1.0, 0.0, 0.0, 0.0])
    bias = np.linalg.solve(np.eye(4) - correct @ chain(period), correct @ input_gain(LUENBERGER_INPUT, period) * w)
    k = AdrcLaw(gains, simulation).numbers[:6]
    return float((k[4] * w + k[:4] @ bias) / k[0])


def settled_rmse(policy: Policy, wind: Any, reference: Any = None) -> tuple[float, float]:
    """Return the RMSE (m) of horizontal bob position and of height over the last 5 of 10 s; no episode terminates."""
    env = QuadPendulumVectorEnv(EPISODES, wind=wind, autoreset_mode=AutoresetMode.DISABLED, duration=11.0)
    _, results = run_policy(policy, env, 1000, options={} if reference is None else {"reference": reference})
    squares = np.mean(np.square([info["tracking_error"] for *_, info in results[500:]]), axis=(0, 1))
    return float(np.sqrt(squares[0] + squares[1])), float(np.sqrt(squares[2]))


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name.startswith("adrc")])
def test_adrc_tracks_circles_in_calm_air(name: str) -> None:
    horizontal, vertical = settled_rmse(controller(name), None, Reference.circle(1.0, 0.6))
    assert horizontal < 1e-4
    assert vertical < 1e-6


def test_paper_gains_have_the_predicted_offset_in_wind_and_matched_gains_have_none() -> None:
    force = 0.1
    wind = Constant((force, 0.0, 0.0))
    paper, _ = settled_rmse(controller("adrc-paper"), wind, Reference.hover())
    matched, _ = settled_rmse(controller("adrc-matched"), wind, Reference.hover())
    assert paper == pytest.approx(force * predicted_offset(tuning("adrc-paper").gains, Simulation()), rel=0.01)
    assert 0.35 < paper / force < 0.4
    assert matched < 1e-5


def test_rmse_in_fluctuating_wind_is_as_documented() -> None:
    """The force has a standard deviation of 0.15 N."""
    assert settled_rmse(controller("adrc-paper"), OrnsteinUhlenbeck(0.15))[0] < 0.08
    assert settled_rmse(controller("adrc-matched"), OrnsteinUhlenbeck(0.15))[0] < 0.003


def test_30_percent_of_false_inertia_does_not_make_the_matched_law_fall() -> None:
    """The force is estimated apart from the torques; read from ϑ̂/K, it made every such episode terminate."""
    inertia = {name: 1.3 * getattr(PAPER, name) for name in ("inertia_roll", "inertia_pitch")}
    vehicle = simulation_of(PAPER._replace(**inertia)).vehicle
    env = QuadPendulumVectorEnv(4, vehicle=vehicle, wind=Constant((0.1, 0.0, 0.0)))
    _, results = run_policy(controller("adrc-matched"), env, 500, options={"reference": Reference.hover()})
    assert not np.any([terminated for *_, terminated, _, _ in results])
    assert np.linalg.norm(results[-1][4]["tracking_error"], axis=1).max() < 1e-3


@pytest.mark.parametrize(("bandwidth", "falls"), [(500.0, True), (15.0, False)])
def test_noise_makes_fast_observers_fall_and_not_slow_ones(bandwidth: float, falls: bool) -> None:
    """With white noise of 1 mm and 1 mrad, all episodes terminate early at ω_n = 500 rad/s and none at 15 rad/s."""
    observer, noise = ObserverGains(bandwidth), Noise(position=1e-3, euler=1e-3, direction=1e-3)
    policy = controller_of("adrc-paper", AdrcGains(luenberger=observer, horizontal=observer, vertical=observer))
    env = QuadPendulumVectorEnv(EPISODES, task="hover", sensors=noise, autoreset_mode=AutoresetMode.SAME_STEP)
    survived = np.any([step.survived for step in rollout(policy, env, 0)], axis=0)
    assert (survived != falls).all()
