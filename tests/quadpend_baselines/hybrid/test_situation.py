"""What the policy observes of noise and wind over the last second."""

import gymnasium as gym

from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_baselines.hybrid.situation import SITUATION_SIZE
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


def test_noise_is_seen_in_the_innovation_and_wind_in_the_disturbance():
    calm, noisy = flown(), flown(noise=Noise(position=0.002, euler_rate=0.02))
    windy = flown(wind="windy")
    assert (noisy[:, [0, 3]] > 0.1).all()
    assert (noisy[:, [0, 3]] > 5 * calm[:, [0, 3]]).all()
    assert (windy[:, 6] > 5 * calm[:, 6]).all()
