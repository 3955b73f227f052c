"""What the policy observes of noise and wind over the last second."""

import gymnasium as gym
import numpy as np

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, situation_inputs, update_situation
from quadpend_gym.sensors import Noise

HYBRID = {"kind": "estimate_only", "base_controller": "flatness", "situation": True}


def flown(wind=None, noise=None):
    """Return the situation that a policy observes when the flatness-based controller flies."""
    env = gym.make_vec("quadpend_gym:QuadPendulum-v0", num_envs=3, wind=wind, sensors=noise)
    env = VectorHybridWrapper(env, HYBRID)
    observation, _ = env.reset(seed=0)
    for _ in range(60):
        observation, *_ = env.step(env.base_action)
    return observation[:, -SITUATION_SIZE:]


def test_a_constant_signal_has_its_own_root_mean_square_from_the_first_step():
    innovation = np.tile(np.repeat([0.002, 0.02], 3), (2, 3))  # of a field, of its rate, and so on
    disturbance = np.tile(np.repeat([2.0, 0.5, 0.1], 3), (2, 1))
    situation = None
    for _ in range(3):
        situation = update_situation(situation, np.zeros(2, bool), innovation, disturbance, 0.01)
    np.testing.assert_allclose(situation_inputs(situation), [[0.2] * 6 + [2.0, 0.5, 0.1, 0.0, 0.0, 0.0]] * 2)


def test_a_new_episode_forgets_the_last_one():
    innovation, loud, calm = np.zeros((2, 18)), np.ones((2, 9)), np.zeros((2, 9))
    before = update_situation(None, np.ones(2, bool), innovation, loud, 0.01)
    after = situation_inputs(update_situation(before, np.array([True, False]), innovation, calm, 0.01))
    assert not after[0].any()
    assert after[1].any()


def test_noise_is_seen_in_the_innovation_and_wind_in_the_disturbance():
    calm, noisy = flown(), flown(noise=Noise(position=0.002, euler_rate=0.02))
    windy = flown(wind="windy")
    assert (noisy[:, [0, 3]] > 0.1).all()
    assert (noisy[:, [0, 3]] > 5 * calm[:, [0, 3]]).all()
    assert (windy[:, 6] > 5 * calm[:, 6]).all()
