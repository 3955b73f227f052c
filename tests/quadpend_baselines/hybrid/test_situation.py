"""What the policy observes of noise and wind over the last second."""

import gymnasium as gym
import numpy as np

from quadpend_baselines.estimation.estimate import LOOP, Estimate
from quadpend_baselines.hybrid import VectorHybridWrapper
from quadpend_baselines.hybrid.parts import Seen
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, situation_part
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


PART = situation_part(0.01, 10.0)  # period (s) and weight (N)


def inputs_of(innovation, disturbance, memory):
    """Return the situation for an innovation and a disturbance, shapes (n, 18) and (n, 9), and its memory."""
    estimate = Estimate(np.zeros((len(innovation), LOOP)))
    estimate.innovation[:], estimate.disturbance[:], estimate.mass_ratio[:] = innovation, disturbance, 1.0
    return PART.function(PART.numbers, Seen(None, None, None, estimate.array, None), memory)


def test_a_constant_signal_has_its_own_root_mean_square_from_the_first_step():
    innovation = np.tile(np.repeat([0.002, 0.02], 3), (2, 3))  # of a field, of its rate, and so on
    disturbance = np.tile(np.repeat([2.0, 0.5, 0.1], 3), (2, 1))
    memory = np.zeros((2, PART.memory_size))
    for _ in range(3):
        found, memory = inputs_of(innovation, disturbance, memory)
    np.testing.assert_allclose(found, [[0.2] * 6 + [2.0, 0.5, 0.1, 0.0, 0.0, 0.0]] * 2)


def test_a_new_episode_forgets_the_last_one():
    loud, calm = np.ones((2, 9)), np.zeros((2, 9))
    _, memory = inputs_of(np.zeros((2, 18)), loud, np.zeros((2, PART.memory_size)))
    memory[0] = 0.0
    after, _ = inputs_of(np.zeros((2, 18)), calm, memory)
    assert not after[0].any()
    assert after[1].any()


def test_noise_is_seen_in_the_innovation_and_wind_in_the_disturbance():
    calm, noisy = flown(), flown(noise=Noise(position=0.002, euler_rate=0.02))
    windy = flown(wind="windy")
    assert (noisy[:, [0, 3]] > 0.1).all()
    assert (noisy[:, [0, 3]] > 5 * calm[:, [0, 3]]).all()
    assert (windy[:, 6] > 5 * calm[:, 6]).all()
