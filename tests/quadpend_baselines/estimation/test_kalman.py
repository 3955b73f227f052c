"""Estimator: exact in calm air, convergence to constant disturbances, Kalman gain, symmetry, and bounded estimates."""

from dataclasses import replace
from functools import lru_cache

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are

from quadpend_baselines.controllers.flatness import Flatness, FlatnessGains
from quadpend_baselines.estimation import estimate
from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.measurement import measurement_from_observation, observation_of
from quadpend_baselines.gains import EstimatorGains, tuning
from quadpend_baselines.modelling.linear_model import (
    DISTURBANCE_COLUMNS,
    EULER_RATE,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    VELOCITY,
    linearise,
)
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import PAPER, Parameters, Reference, Simulation, StartSettings, Task
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import SCENARIOS
from quadpend_gym.sensors import Noise
from quadpend_gym.tasks.observation import OBSERVATION_SCALE, OUTPUT_FEEDBACK, OUTPUT_FEEDBACK_COLUMNS
from quadpend_gym.wind import Constant
from tests.helpers.controllers import (
    CALM,
    disturbance_of,
    flat_state_and_command,
    simulate_with_true_state,
    simulation_of,
)
from tests.helpers.envs import make_vec
from tests.helpers.physics import UNEQUAL

# Gains with a short memory, below one second, and those of the controllers.
FAST = EstimatorGains(noise=1e-3, rate_noise=1e-2, force_walk=2.0, bob_force_walk=0.5, torque_walk=0.5)
ALL_GAINS = {"fast": FAST} | {name: tuning(name).gains.estimator for name in ("lqr", "flatness")}
every_gain = pytest.mark.parametrize("gains", ALL_GAINS.values(), ids=ALL_GAINS.keys())
OUTPUTS = Loop(observation=OUTPUT_FEEDBACK)
every_measurement = pytest.mark.parametrize("has_rates", [True, False], ids=["all states", "outputs"])
CIRCLE = Reference(
    offset=(0.5, 0.0, 2.0, 0.4),
    rate=(0.0, 0.1, 0.2, 0.3),
    amplitude=(1.0, 1.0, 0.0, 0.3),
    frequency=(1.0, 1.0, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)
WIND = disturbance_of((0.3, -0.2, 0.4), (0.08, -0.05, 0.0), (0.1, -0.05, 0.03))

Recording = list[tuple[Estimate, Floats]]


@lru_cache(maxsize=16)
def record(reference: Reference, wind: tuple[float, ...], p: Parameters = PAPER, steps: int = 200) -> Recording:
    """Return measurements and commands of two rows; the second row does not start on the reference."""
    simulation, recording = simulation_of(p), []
    law = Flatness(FlatnessGains(), simulation)
    start = np.repeat(flat_state_and_command(reference, 0.0, CALM, p)[0], 2, axis=0)
    deviating = State(start[1])
    deviating.position[:] += [0.05, -0.1, 0.1]
    deviating.velocity[:] += [0.1, 0.05, -0.05]
    deviating.euler_rate[:] += [0.1, -0.1, 0.2]
    simulate_with_true_state(
        law, simulation, start, steps, reference, np.array(wind), lambda *args: recording.append(args[:2])
    )
    return recording


def observed(measurement: Estimate, has_rates: bool = True, length: float = PAPER.rod_length) -> Floats:
    """Return the observation of a measurement in double precision; l in m."""
    state, fields = State(measurement.state), np.empty((len(measurement.array), 36))
    error, attitude = state.position.copy(), state.euler.copy()
    error_rate = state.velocity.copy()
    error[:, :2] += length * state.direction[:, :2]
    error_rate[:, :2] += length * state.direction_rate[:, :2]
    attitude[:, 2] -= measurement.yaw[:, 0]
    parts = error, error_rate, state.direction, state.direction_rate, attitude, state.euler_rate
    fields[:, :18], fields[:, 18:] = np.hstack(parts), measurement.array[:, estimate.REFERENCE : estimate.MASS_RATIO]
    fields /= OBSERVATION_SCALE
    return fields if has_rates else fields[:, OUTPUT_FEEDBACK_COLUMNS]


def estimates(recording: Recording, gains: EstimatorGains, has_rates: bool, p: Parameters = PAPER) -> list[Estimate]:
    """Return the estimates of a recording, step by step."""
    observer = Estimator(gains, simulation_of(p), Loop() if has_rates else OUTPUTS)
    observations = [observed(measurement, has_rates, p.rod_length) for measurement, _ in recording]
    out = [observer.observe(observations[0])]
    for observation, (_, command) in zip(observations[1:], recording[:-1], strict=True):
        out.append(observer.observe(observation, out[-1], to_action(command, observer.simulation)))
    return out


@every_gain
def test_estimates_are_exact_in_calm_air_and_acceleration_is_not_mistaken_for_wind(gains: EstimatorGains) -> None:
    """On a climbing circle with a changing heading, the estimated disturbance is rounding error, about 10⁻¹² N."""
    recording = record(CIRCLE, tuple(CALM))
    for found, (measurement, _) in zip(estimates(recording, gains, has_rates=True), recording, strict=True):
        assert_allclose(found.state, measurement.state, atol=1e-12)
        assert_allclose(found.disturbance, 0.0, atol=1e-10)


@every_measurement
@pytest.mark.parametrize("only", [slice(0, 3), slice(3, 6), slice(6, 9), slice(0, 9)], ids=["Q", "B", "torque", "all"])
def test_constant_disturbances_are_estimated_and_distinguished(only: slice, has_rates: bool) -> None:
    """The error is below 1 mN after half a second and below 10⁻⁹ N after two seconds."""
    wind = np.zeros(9)
    wind[only] = WIND[only]
    recording = record(CIRCLE, tuple(wind), UNEQUAL)
    estimated = estimates(recording, FAST, has_rates, UNEQUAL)
    for step, error in ((50, 1e-3), (100, 1e-5), (199, 1e-9)):
        assert_allclose(estimated[step].disturbance, np.tile(wind, (2, 1)), atol=error)
    assert_allclose(estimated[-1].state, recording[-1][0].state, atol=1e-10)


def test_the_gain_of_strong_wind_applies_where_the_bob_is_pushed() -> None:
    """Below it is the one of calm air, and in between the mean of both, weighed by the square of the force."""
    recording = record(CIRCLE, tuple(WIND))
    calm, gust = FAST, replace(FAST, bob_force_walk=2.0)
    (measurement, _), (after, command) = recording[:2]
    limit = 0.02 * PAPER.bob_mass * PAPER.gravity

    def correction(gains: EstimatorGains, force: float) -> Floats:
        observer = Estimator(gains, simulation_of(PAPER))
        before = observer.observe(observed(measurement))
        before.disturbance[:, 3] = force
        return observer.observe(observed(after), before, to_action(command, observer.simulation)).array

    both = replace(FAST, gust_walk=2.0)
    assert_array_equal(correction(both, 0.0), correction(calm, 0.0))
    assert_allclose(correction(both, 1.5 * limit), correction(gust, 1.5 * limit), atol=1e-12)
    mean = 0.75 * correction(calm, 0.5 * limit) + 0.25 * correction(gust, 0.5 * limit)
    force = slice(estimate.DISTURBANCE, estimate.PLACE)
    assert_allclose(correction(both, 0.5 * limit)[:, force], mean[:, force], atol=1e-12)


def test_the_known_noise_of_a_scenario_lowers_the_gain_where_it_is_larger() -> None:
    gains, simulation = replace(FAST, models_loop=True), simulation_of(PAPER)
    quiet, known = Estimator(gains, simulation), Loop.of([Noise(position=1e-4, direction=0.01, level=(1.0, 3.0))])
    assert_array_equal(Estimator(FAST, simulation, known).tables[0], Estimator(FAST, simulation).tables[0])
    before, noisy = quiet.tables[0][99], Estimator(gains, simulation, known).tables[0][99]
    assert noisy[PENDULUM, PENDULUM].trace() < 0.5 * before[PENDULUM, PENDULUM].trace()
    assert_allclose(known.noise, [1e-4 * np.sqrt(13.0 / 3.0), 0.0, 0.01 * np.sqrt(13.0 / 3.0)])


@every_gain
@every_measurement
def test_gain_converges_to_that_of_the_steady_kalman_filter_and_is_stable(
    gains: EstimatorGains, has_rates: bool
) -> None:
    """The gain agrees with scipy's Riccati equation to 10 %; all poles of the error lie inside the unit circle."""
    simulation, size = Simulation(), MODEL_STATE_SIZE + DISTURBANCE_COLUMNS.size
    model, transition = linearise(simulation), np.eye(size)
    transition[:MODEL_STATE_SIZE] = np.hstack([model.transition, model.disturbance])
    walk = np.diag([gains.force_walk] * 3 + [gains.bob_force_walk] * 2 + [gains.torque_walk] * 3)
    process = np.zeros((size, size))
    process[MODEL_STATE_SIZE:, MODEL_STATE_SIZE:] = simulation.period * walk**2
    is_rate = np.isin(np.arange(MODEL_STATE_SIZE), np.r_[VELOCITY, EULER_RATE, PENDULUM_RATE])
    noise = np.where(is_rate, gains.rate_noise, gains.noise) ** 2
    measured = np.full(MODEL_STATE_SIZE, True) if has_rates else ~is_rate
    output, noise = np.eye(size)[:MODEL_STATE_SIZE][measured], np.diag(noise[measured])
    covariance = solve_discrete_are(transition.T, output.T, process, noise)
    steady = covariance @ output.T @ np.linalg.inv(output @ covariance @ output.T + noise)
    gain = Estimator(gains, Simulation()).tables[has_rates][99][:, measured]
    assert np.linalg.norm(gain - steady) < 0.1 * np.linalg.norm(steady)
    error = (np.eye(len(transition)) - gain @ output) @ transition
    assert np.abs(np.linalg.eigvals(error)).max() < 0.99


def test_rates_that_are_not_measured_begin_with_those_of_a_start_on_the_reference() -> None:
    """With a pole of inertia, those of a point mass in its centre of mass are off by 0.8 mm/s and 1.4 mrad/s.

    The start of the environment takes derivatives of the reference above order 6 for 0: 0.02 mm/s and 0.04 mrad/s here.
    """
    simulation, task = Simulation(vehicle="hummingbird"), Task(start=StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    env = make_vec(20, simulation, task=task)
    observation, _ = env.reset(seed=2)
    start = State(measurement_from_observation(observation, simulation.parameters.rod_length).state)
    begun = State(Estimator(FAST, simulation, OUTPUTS).observe(observation[:, OUTPUT_FEEDBACK_COLUMNS]).state)
    assert_allclose(begun.velocity, start.velocity, atol=3e-5)
    assert_allclose(begun.direction_rate, start.direction_rate, atol=5e-5)


def test_observation_of_an_estimate_inverts_measurement_from_observation() -> None:
    observation = np.random.default_rng(0).normal(size=(200, 36)).astype(np.float32)
    measured = measurement_from_observation(observation, PAPER.rod_length)
    assert_allclose(observation_of(measured, PAPER.rod_length), observation, atol=3e-6)
    assert_array_equal(observation_of(measured, PAPER.rod_length)[:, 18:], observation[:, 18:])


@pytest.mark.parametrize("angle", [2.4, 3.1])
def test_wind_is_estimated_while_the_pendulum_hangs(angle: float) -> None:
    """If all states are measured; they are the estimate then. The pendulum swings from an angle (rad) for 0.3 s."""
    force = (0.2, -0.1, 0.15)
    env = gym.make_vec("quadpend_gym:QuadPendulum-v0", 2, scenario=SCENARIOS["swing_up"], wind=Constant(force=force))
    state = {"direction": (np.sin(angle), 0.0, np.cos(angle)), "position": (0.0, 0.0, 3.0)}
    observation, _ = env.reset(seed=1, options={"state": state})
    observer = Estimator(tuning("lqr").gains.estimator, Simulation())
    found = observer.observe(observation)
    for _ in range(30):
        observation, *_ = env.step(np.zeros((2, 4), np.float32))
        found = observer.observe(observation, found, np.zeros((2, 4), np.float32))
    assert_allclose(found.disturbance[:, :3], [force, force], atol=0.03)
    assert_array_equal(found.state, measurement_from_observation(observation, PAPER.rod_length).state)
