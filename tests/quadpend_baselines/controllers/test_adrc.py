"""ADRC: tracking, steady offsets, disturbance estimates, and the `predict` protocol."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from quadpend_baselines.paper.ablations import AblationCase, predicted_offset, simulate
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from quadpend_baselines import ADRC, ADRC_GAINS, AdrcGains, ObserverGains, controller
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import (
    PAPER,
    Constant,
    OrnsteinUhlenbeck,
    QuadPendulumEnv,
    QuadPendulumVectorEnv,
    Reference,
    Simulation,
)
from quadpend_gym.actuators import GyroBias
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import find_scenario
from quadpend_train import run_episodes
from quadpend_train.envs.sb3_vec_env import SB3VecEnv

EPISODES = 30


def settled_squares(policy: ADRC, wind: object, reference: Any = None) -> Floats:
    """Return the mean square error (m²) of the bob over the last 5 of 10 s, shape (n, 3); no episode terminates."""
    env = QuadPendulumVectorEnv(EPISODES, wind=wind, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=None)
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
    paper, _ = settled_rmse(ADRC("paper"), OrnsteinUhlenbeck(0.15))
    matched, _ = settled_rmse(ADRC("matched"), OrnsteinUhlenbeck(0.15))
    assert paper < 0.08
    assert matched < 0.003


@pytest.mark.parametrize("ratio", [0.7, 1.3])
def test_30_percent_of_false_inertia_does_not_make_the_matched_law_fall(ratio: float) -> None:
    """The force is estimated apart from the torques; read from ϑ̂/K, it made every such episode terminate."""
    inertia = {name: ratio * getattr(PAPER, name) for name in ("inertia_roll", "inertia_pitch")}
    env = QuadPendulumVectorEnv(
        4, simulation=Simulation(replace(PAPER, **inertia)), wind=Constant((0.1, 0.0, 0.0)), max_episode_steps=None
    )
    observation, _ = env.reset(seed=0, options={"reference": Reference.hover()})
    policy, memory = ADRC("matched"), None
    for _ in range(500):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
    assert np.linalg.norm(info["tracking_error"], axis=1).max() < 1e-3


def test_a_biased_gyro_leaves_no_offset() -> None:
    """A bias of about 1°/s, which the matched law with ϑ̂/K answers with an offset of 0.4 m."""
    scenario = replace(find_scenario("as_flown"), actuators=GyroBias(0.02), sensors=None, duration=5.0)
    results = run_episodes([controller("adrc-matched")], scenario, 2)
    assert results.survived.all()
    assert results.settled_rmse.max() < 0.03


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


def test_single_and_batched_predictions_are_equal() -> None:
    env, policy = QuadPendulumVectorEnv(3), ADRC()
    observation, _ = env.reset(seed=0)
    batch_memory, single_memory = None, [None] * 3
    for _ in range(20):
        batch, batch_memory = policy.predict(observation, batch_memory)
        for row in range(3):
            single, single_memory[row] = policy.predict(observation[row], single_memory[row])
            assert single.shape == (4,)
            np.testing.assert_allclose(single, batch[row], atol=1e-6)
        observation, *_ = env.step(batch)


def test_predict_depends_on_the_given_memory_only_and_episode_start_resets_a_row() -> None:
    env, policy = QuadPendulumVectorEnv(2), ADRC()
    first, _ = env.reset(seed=0)
    action, memory = policy.predict(first)
    second, *_ = env.step(action)
    continued, _ = policy.predict(second, memory)
    repeated, _ = policy.predict(second, memory)
    np.testing.assert_array_equal(continued, repeated)
    fresh, _ = policy.predict(second)
    mixed, _ = policy.predict(second, memory, np.array([True, False]))
    np.testing.assert_array_equal(mixed[0], fresh[0])
    np.testing.assert_array_equal(mixed[1], continued[1])


def test_evaluate_policy_of_sb3_accepts_the_controller() -> None:
    single = Monitor(gym.make("quadpend_gym:QuadPendulumHover-v0"))
    mean, _ = evaluate_policy(ADRC(), single, n_eval_episodes=1)  # type: ignore[arg-type]
    vector = SB3VecEnv(
        QuadPendulumVectorEnv(4, task="hover", wind=OrnsteinUhlenbeck(0.1), autoreset_mode=AutoresetMode.SAME_STEP)
    )
    returns, lengths = evaluate_policy(ADRC(), vector, n_eval_episodes=8, return_episode_rewards=True)  # type: ignore[arg-type]
    assert mean > 900.0
    assert lengths == [1000] * 8
    assert min(returns) > 700.0  # type: ignore[type-var, operator]


def test_to_action_returns_the_saturated_command() -> None:
    action, applied = to_action(np.array([[100.0, 7.0, -2.5, -3.0]]), Simulation())
    np.testing.assert_allclose(action, [[1.0, 1.0, -0.5, -1.0]])
    np.testing.assert_allclose(applied, [[2 * PAPER.hover_thrust, 5.0, -2.5, -1.0]])


def test_unknown_gains_raise_an_error_that_lists_the_names() -> None:
    with pytest.raises(ValueError, match="no ADRC gains 'nix'; there are paper, matched"):
        ADRC("nix")


def test_rmse_does_not_depend_on_the_heading() -> None:
    """ADRC rotates roll and pitch into the world frame; a yaw of 90° must not change the tracking error."""
    north, _ = settled_rmse(
        ADRC("matched"), None, Reference(offset=(0, 0, 2, 0), amplitude=(1, 0, 0, 0), frequency=0.6)
    )
    rotated = Reference(offset=(0, 0, 2, np.pi / 2), amplitude=(1, 0, 0, 0), frequency=0.6)
    assert settled_rmse(ADRC("matched"), None, rotated)[0] == pytest.approx(north, rel=0.05)


@pytest.mark.parametrize(("bandwidth", "survivors"), [(500.0, 0.0), (15.0, 1.0)])
def test_noise_makes_fast_observers_fall_and_not_slow_ones(bandwidth: float, survivors: float) -> None:
    """With white noise of 1 mm and 1 mrad, all episodes terminate early at ω_n = 500 rad/s and none at 15 rad/s."""
    observer = ObserverGains(bandwidth)
    gains = AdrcGains(luenberger=observer, horizontal=observer, vertical=observer)
    assert simulate(AblationCase("noise", "1 mm and 1 mrad", gains, noise=1e-3)).survival == survivors
