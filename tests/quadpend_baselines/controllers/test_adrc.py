"""ADRC: tracking, steady offsets, disturbance estimates, and the `predict` protocol."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from experiments.paper_ablations import Case, cases, simulate
from quadpend_baselines import ADRC, ADRC_GAINS, AdrcGains, ObserverGains
from quadpend_baselines.paper.faults import predicted_offset
from quadpend_gym import (
    PAPER,
    Constant,
    OrnsteinUhlenbeck,
    QuadPendulumEnv,
    QuadPendulumVectorEnv,
    Reference,
    Simulation,
)
from quadpend_gym.core.arrays import Floats
from tests.helpers.controllers import simulation_of

EPISODES = 30


def settled_squares(policy: ADRC, wind: object, reference: Any = None) -> Floats:
    """Return the mean square error (m²) of the bob over the last 5 of 10 s, shape (n, 3); no episode terminates."""
    env = QuadPendulumVectorEnv(EPISODES, wind=wind, autoreset_mode=AutoresetMode.DISABLED, duration=11.0)
    observation, _ = env.reset(seed=7, options={} if reference is None else {"reference": reference})
    memory, errors = None, []
    for step in range(1000):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
        if step >= 500:
            errors.append(info["tracking_error"])
    return np.asarray(np.mean(np.square(errors), axis=0))


def settled_rmse(policy: ADRC, wind: object, reference: Any = None) -> tuple[float, float]:
    """Return the RMSE (m) of horizontal bob position and of height over the last 5 of 10 s of all episodes."""
    squares = settled_squares(policy, wind, reference).mean(axis=0)
    return float(np.sqrt(squares[0] + squares[1])), float(np.sqrt(squares[2]))


@pytest.mark.parametrize("gains", ADRC_GAINS)
def test_adrc_tracks_circles_in_calm_air(gains: str) -> None:
    """A third of the episodes has each radius."""
    circles = [Reference.circle(radius, 0.6) for radius in np.repeat([0.5, 1.0, 1.5], EPISODES // 3)]
    squares = settled_squares(ADRC(gains), None, circles).reshape(3, EPISODES // 3, 3).mean(axis=1)
    assert (np.sqrt(squares[:, 0] + squares[:, 1]) < 1e-4).all()
    assert (np.sqrt(squares[:, 2]) < 1e-6).all()


def test_paper_gains_have_the_predicted_offset_in_wind_and_matched_gains_have_none() -> None:
    force = 0.1
    wind = Constant((force, 0.0, 0.0))
    paper, _ = settled_rmse(ADRC("paper"), wind, Reference.hover())
    matched, _ = settled_rmse(ADRC("matched"), wind, Reference.hover())
    assert paper == pytest.approx(force * predicted_offset(ADRC_GAINS["paper"], Simulation()), rel=0.01)
    assert 0.35 < paper / force < 0.4
    assert matched < 1e-5


def test_rmse_in_fluctuating_wind_is_as_documented() -> None:
    """The force has a standard deviation of 0.15 N."""
    assert settled_rmse(ADRC("paper"), OrnsteinUhlenbeck(0.15))[0] < 0.08
    assert settled_rmse(ADRC("matched"), OrnsteinUhlenbeck(0.15))[0] < 0.003


@pytest.mark.parametrize("ratio", [0.7, 1.3])
def test_30_percent_of_false_inertia_does_not_make_the_matched_law_fall(ratio: float) -> None:
    """The force is estimated apart from the torques; read from ϑ̂/K, it made every such episode terminate."""
    inertia = {name: ratio * getattr(PAPER, name) for name in ("inertia_roll", "inertia_pitch")}
    vehicle = simulation_of(PAPER._replace(**inertia)).vehicle
    env = QuadPendulumVectorEnv(4, vehicle=vehicle, wind=Constant((0.1, 0.0, 0.0)))
    observation, _ = env.reset(seed=0, options={"reference": Reference.hover()})
    policy, memory = ADRC("matched"), None
    for _ in range(500):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
    assert np.linalg.norm(info["tracking_error"], axis=1).max() < 1e-3


@pytest.mark.parametrize("force", [(0.1, -0.2, 0.0), (0.0, 0.0, 0.15)])
def test_estimated_disturbance_converges_to_the_true_one_in_steady_wind(force: tuple[float, float, float]) -> None:
    env, policy = QuadPendulumEnv(wind=Constant(force, torque=(0.0, 0.0, 0.03))), ADRC("matched")
    observation, _ = env.reset(seed=3, options={"reference": Reference.hover()})
    memory = None
    for _ in range(800):
        action, memory = policy.predict(observation, memory)
        observation, _, _, _, info = env.step(action)
    assert memory is not None
    np.testing.assert_allclose(policy.estimated_disturbance(memory)[0], info["disturbance"], atol=5e-4)


@pytest.mark.parametrize(("bandwidth", "survivors"), [(500.0, 0.0), (15.0, 100.0)])
def test_noise_makes_fast_observers_fall_and_not_slow_ones(bandwidth: float, survivors: float) -> None:
    """With white noise of 1 mm and 1 mrad, all episodes terminate early at ω_n = 500 rad/s and none at 15 rad/s."""
    observer = ObserverGains(bandwidth)
    gains = AdrcGains(luenberger=observer, horizontal=observer, vertical=observer)
    assert simulate(Case("noise", "1 mm and 1 mrad", gains, noise=1e-3))["survival (%)"] == survivors


def test_the_sign_term_falls_where_a_saturation_does_not() -> None:
    chosen = {case.name: simulate(case, 600, 400) for case in cases() if "ρ = 5e6" in case.name}
    saturated, sign = chosen.values()
    assert saturated["survival (%)"] == 100.0
    assert sign["survival (%)"] < 80.0
    assert sign["settled RMSE (mm)"] > 3.0 * saturated["settled RMSE (mm)"]
