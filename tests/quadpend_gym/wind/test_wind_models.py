"""Constant, sinusoidal and drawn winds, and gusts, obey their equations."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from quadpend_gym import Constant, Drawn, Gusts, OrnsteinUhlenbeck, PaperGusts, Rescaled, Sinusoid, Step
from quadpend_gym.core.streams import Streams
from tests.helpers.wind import PERIOD, five_sigma, sample_wind


def uniform(low: float, high: float) -> Any:
    """Return the cumulative distribution function of the uniform distribution between two numbers."""
    return stats.uniform(low, high - low).cdf


def test_a_constant_wind_is_constant() -> None:
    wind = Constant(force=(1.0, 2.0, 3.0), bob_force=(0.0, 0.0, -0.5), torque=0.25, velocity=(4.0, 0.0, -5.0))
    loads = (1, 2, 3, 0, 0, -0.5, 0.25, 0.25, 0.25, 4, 0, -5)
    assert_array_equal(sample_wind(wind, 20, 3), np.broadcast_to(loads, (20, 3, 12)))


@pytest.mark.parametrize(("load", "column"), [("force", 0), ("bob_force", 3), ("torque", 6), ("velocity", 9)])
def test_a_sinusoid_has_its_amplitude_frequency_and_a_random_phase(load: str, column: int) -> None:
    amplitude, frequency = 0.7, 3.0
    wind = Sinusoid(**{load: (amplitude, 0.0, 0.0)}, frequency=frequency)
    out = sample_wind(wind, 400, 2000)
    assert_array_equal(np.delete(out, column, axis=-1), 0.0)
    wave = out[..., column]
    # A sinusoid solves d_{k+1} + d_{k−1} = 2 cos(ωT) d_k …
    cosine = np.cos(frequency * PERIOD)
    assert_allclose(wave[2:] + wave[:-2], 2.0 * cosine * wave[1:-1], atol=1e-12)
    # … with this invariant, from which its amplitude follows.
    invariant = wave[1:] ** 2 + wave[:-1] ** 2 - 2.0 * cosine * wave[1:] * wave[:-1]
    assert_allclose(invariant, (amplitude * np.sin(frequency * PERIOD)) ** 2, rtol=1e-9)
    # The sine of a uniform phase is distributed by the arcsine law.
    assert stats.kstest(wave[0], stats.arcsine(-amplitude, 2.0 * amplitude).cdf).pvalue > 0.01


def test_a_step_begins_at_its_time_rises_and_stays() -> None:
    out = sample_wind(Step(bob_force=(0.0, 0.2, 0.0), velocity=(3.0, 0.0, 0.0), at=1.0, rise=0.1), 300, 2)
    time = PERIOD * (np.arange(300) + 0.5)
    share = np.where(time < 1.0, 0.0, np.where(time < 1.1, np.sin(0.5 * np.pi * (time - 1.0) / 0.1) ** 2, 1.0))
    for row in range(2):
        assert_allclose(out[:, row], np.outer(share, np.eye(12)[4] * 0.2 + np.eye(12)[9] * 3.0), atol=1e-12)
    begins = Step(force=0.1, at=(2.0, 5.0)).initial_memory(Streams.from_seeds(list(range(1000))))[:, 0]
    assert stats.kstest(begins, uniform(2.0, 5.0)).pvalue > 0.01


EVERY_LOAD = Constant(
    force=(3.0, 4.0, 2.0), bob_force=(0.0, 1.0, 0.0), torque=(0.1, 0.2, 0.3), velocity=(5.0, 0.0, -1.0)
)


def test_a_drawn_wind_is_scaled_and_rotated_and_constant_for_the_episode() -> None:
    out = sample_wind(Drawn(EVERY_LOAD, strength=(0.5, 2.0), heading=(-1.0, 2.0)), 10, 3000)
    assert_array_equal(out, np.broadcast_to(out[0], out.shape))  # constant in the episode
    force, bob_force, torque, velocity = np.split(out[0], 4, axis=-1)
    strength = np.hypot(*force[:, :2].T) / 5.0  # relative to the norm of the horizontal force (3, 4)
    heading = np.arctan2(bob_force[:, 1], bob_force[:, 0]) - np.pi / 2.0  # the unrotated force (0, 1) points along y
    heading = (heading + np.pi) % (2.0 * np.pi) - np.pi
    assert stats.kstest(strength, uniform(0.5, 2.0)).pvalue > 0.01
    assert stats.kstest(heading, uniform(-1.0, 2.0)).pvalue > 0.01
    assert abs(np.corrcoef(strength, heading)[0, 1]) < five_sigma(3000)
    # Horizontal vectors rotate as complex numbers; vertical components and torques are only scaled.
    turn = strength * np.exp(1j * heading)
    for part, (x, y, z) in ((force, (3, 4, 2)), (bob_force, (0, 1, 0)), (velocity, (5, 0, -1))):
        assert_allclose(part[:, 0] + 1j * part[:, 1], turn * (x + 1j * y), rtol=1e-12)
        assert_allclose(part[:, 2], strength * z, rtol=1e-12)
    assert_allclose(torque, np.outer(strength, (0.1, 0.2, 0.3)), rtol=1e-12)


def test_a_rescaled_wind_has_scaled_forces_and_torques_and_the_same_velocity() -> None:
    factors = np.repeat([0.5, 0.5, 0.5, 1.0], 3)  # of force, bob force, torque and velocity
    for wind in (EVERY_LOAD, OrnsteinUhlenbeck(force=0.3, velocity=1.0)):
        scaled = sample_wind(Rescaled(wind, 0.5), 10, 3)
        assert_allclose(scaled, factors * sample_wind(wind, 10, 3), rtol=1e-15)
        assert_array_equal(sample_wind(Rescaled(wind, 1.0), 10, 3), sample_wind(wind, 10, 3))
    factors[6:9] = 2.0, 3.0, 4.0
    scaled = sample_wind(Rescaled(EVERY_LOAD, 0.5, (2.0, 3.0, 4.0)), 10, 3)
    assert_allclose(scaled, factors * sample_wind(EVERY_LOAD, 10, 3), rtol=1e-15)


def test_a_gust_is_the_squared_sine_of_the_time_since_its_onset() -> None:
    """Gusts of 0.5 s begin after 1 s, 2.5 s, 4 s, …; each step has the value in the middle of its period."""
    loads = np.array([0.3, -0.2, 0.1, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 6.0, 0.0, -2.0])
    force, bob_force, _, velocity = (tuple(part) for part in loads.reshape(4, 3))
    wind = Gusts(force, bob_force, velocity=velocity, pause=(1.0, 1.0), length=(0.5, 0.5), heading=(0.0, 0.0))
    time = PERIOD * (np.arange(500) + 0.5)
    since_onset = time % 1.5 - 1.0
    shape = np.where(since_onset > 0.0, np.sin(np.pi * since_onset / 0.5) ** 2, 0.0)
    out = sample_wind(wind, 500, 2)
    for row in range(2):
        assert_allclose(out[:, row], np.outer(shape, loads), rtol=0.0, atol=1e-12)
    assert_array_equal(out[:100], 0.0)


def test_pauses_lengths_and_headings_of_gusts_are_uniform_and_independent() -> None:
    bounds = {"pause": (0.3, 1.0), "length": (0.4, 0.8), "heading": (-2.0, 1.0)}
    onset, length, cosine, sine, _ = Gusts(**bounds).initial_memory(Streams.from_seeds(list(range(2000)))).T
    drawn = np.array([onset, length, np.arctan2(sine, cosine)])
    for values, (low, high) in zip(drawn, bounds.values(), strict=True):
        assert stats.kstest(values, uniform(low, high)).pvalue > 0.01
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < five_sigma(2000)


def test_gusts_shorter_than_a_control_period_are_counted() -> None:
    """A step has dozens of gusts; its wind is that of the gust in the middle of the step, if there is one."""
    pause, length, period = 0.7e-2, 1.3e-2, 0.773
    wind = Gusts(force=(1.0, 0.0, 0.0), pause=(pause, pause), length=(length, length), heading=(0.0, 0.0))
    force = sample_wind(wind, 20, 1, period)[:, 0, 0]
    since_onset = period * (np.arange(20) + 0.5) % (pause + length) - pause
    assert_allclose(force, np.where(since_onset > 0.0, np.sin(np.pi * since_onset / length) ** 2, 0.0), atol=1e-9)
    assert 0 < np.count_nonzero(force) < 20


def test_the_gusts_of_the_paper_are_zero_before_their_onset_then_bounded_and_smooth() -> None:
    amplitude, hold = np.array([0.3, 0.2, 0.1, 0.05]), 0.5
    wind = PaperGusts(force=(0.3, 0.2, 0.1), yaw_torque=0.05, onset=1.0, hold=hold)
    out = sample_wind(wind, 600, 200)
    gusts = out[..., [0, 1, 2, 8]]
    assert_array_equal(out[:100], 0.0)
    assert_array_equal(np.delete(out, [0, 1, 2, 8], axis=-1), 0.0)
    assert (np.abs(gusts) <= amplitude).all()
    assert (np.abs(gusts[150:]).max(axis=(0, 1)) > 0.98 * amplitude).all()
    # Half a cosine connects targets that differ by at most 2 amplitudes.
    assert (np.abs(np.diff(gusts, axis=0)) <= np.pi * amplitude * PERIOD / hold).all()
    # The targets are reached at the end of each interval, and they are uniform.
    targets = 0.5 * (gusts[149:-1:50] + gusts[150::50]) / amplitude
    assert stats.kstest(targets.ravel(), uniform(-1.0, 1.0)).pvalue > 0.01
