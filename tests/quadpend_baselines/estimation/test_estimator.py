"""The estimator is exact in calm, finds every constant force that can be told, and sees no ghosts."""

from functools import lru_cache

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are

from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.estimation import estimator
from quadpend_baselines.estimation.estimator import Estimate, Estimator, Measurement, measurement_from_observation
from quadpend_baselines.gains import GAINS, EstimatorGains, FlatnessGains
from quadpend_baselines.modelling.linear_model import DISTURBANCE_COLUMNS, MODEL_STATE_SIZE, linearise
from quadpend_gym import PAPER, Parameters, QuadPendulumVectorEnv, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK_COLUMNS
from tests.helpers.controllers import (
    CALM,
    HOVER,
    flat_state_and_command,
    measurement_of,
    rotate_states,
    rotate_vectors,
    simulate_with_true_state,
    tilted_pendulum,
)
from tests.helpers.physics import UNEQUAL

# Gains that forget within a second, and those of the controllers.
QUICK = EstimatorGains(noise=1e-3, rate_noise=1e-2, force_walk=2.0, bob_force_walk=0.5, torque_walk=0.5)
EVERY = {"quick": QUICK} | {name: gains.estimator for name, gains in GAINS.items() if hasattr(gains, "estimator")}
every_gain = pytest.mark.parametrize("gains", EVERY.values(), ids=EVERY.keys())
feedbacks = pytest.mark.parametrize("rates", [True, False], ids=["whole", "outputs"])
CIRCLE = Reference(
    offset=(0.5, 0.0, 2.0, 0.4),
    rate=(0.0, 0.1, 0.2, 0.3),
    amplitude=(1.0, 1.0, 0.0, 0.3),
    frequency=(1.0, 1.0, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)
WINDS = {
    "on the quadrotor": [0.3, -0.2, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "on the bob": [0.0, 0.0, 0.0, 0.08, -0.05, 0.0, 0.0, 0.0, 0.0],
    "torque": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, -0.05, 0.03],
    "all": [0.3, -0.2, 0.4, 0.08, -0.05, 0.0, 0.1, -0.05, 0.03],
}

Flight = list[tuple[Measurement, Floats]]


@lru_cache(maxsize=16)
def flight(reference: Reference, wind: tuple[float, ...], p: Parameters = PAPER, steps: int = 200) -> Flight:
    """What two rows see, one from the exact flight and one from beside it, and the commands that follow."""
    simulation, seen = Simulation(p), []
    law = Flatness(FlatnessGains(), simulation)
    start = np.repeat(flat_state_and_command(reference, 0.0, CALM, p)[0], 2, axis=0)
    beside = State(start[1])
    beside.position[:] += [0.05, -0.1, 0.1]
    beside.velocity[:] += [0.1, 0.05, -0.05]
    beside.euler_rate[:] += [0.1, -0.1, 0.2]
    simulate_with_true_state(law, simulation, start, steps, reference, np.array(wind), lambda *it: seen.append(it[:2]))
    return seen


def hidden(measurement: Measurement) -> Measurement:
    """The same without rates."""
    state = State(measurement.state.copy())
    for rate in (state.velocity, state.euler_rate, state.direction_rate):
        rate[:] = np.nan
    return measurement._replace(state=state.array)


def estimates(seen: Flight, gains: EstimatorGains, rates: bool, p: Parameters = PAPER) -> list[Estimate]:
    """What the estimator makes of a flight, step after step."""
    observer = Estimator(gains, Simulation(p))
    shown = [measurement if rates else hidden(measurement) for measurement, _ in seen]
    out = [observer.initial_estimate(shown[0])]
    for measurement, (_, command) in zip(shown[1:], seen[:-1], strict=True):
        out.append(observer.update(out[-1], command, measurement))
    return out


@pytest.mark.parametrize("size", [36, 27])
def test_an_observation_is_read_in_the_references_frame(size: int) -> None:
    """To single precision; of rates that are not observed it says so."""
    env = QuadPendulumVectorEnv(5, simulation=Simulation(UNEQUAL), autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=3, options={"reference": CIRCLE})
    for _ in range(10):
        observation = env.step(np.full((5, 4), 0.05, np.float32))[0]
    true = measurement_of(env.world.state, CIRCLE, 0.1)
    if size == 27:
        observation, true = observation[:, OUTPUT_FEEDBACK_COLUMNS], hidden(true)
    for actual, wanted in zip(measurement_from_observation(observation, UNEQUAL.rod_length), true, strict=True):
        assert_allclose(actual, wanted, rtol=1e-6, atol=1e-6)


@every_gain
@pytest.mark.parametrize("reference", [HOVER, CIRCLE], ids=["hover", "circle"])
def test_in_calm_a_known_plant_is_known_exactly_and_acceleration_is_no_wind(
    gains: EstimatorGains, reference: Reference
) -> None:
    """What it takes for a wind on a climbing, turning circle is 10⁻¹² N: rounding."""
    seen = flight(reference, tuple(CALM))
    for estimate, (measurement, _) in zip(estimates(seen, gains, rates=True), seen, strict=True):
        assert_allclose(estimate.state, measurement.state, atol=1e-12)
        assert_allclose(estimate.disturbance, 0.0, atol=1e-10)


@every_gain
def test_hidden_rates_are_found(gains: EstimatorGains) -> None:
    """Off by 0.8 rad/s at first, by a hundredth of it after 0.3 s, and less and less."""
    seen = flight(CIRCLE, tuple(CALM))
    found = estimates(seen, gains, rates=False)
    errors = [np.abs(found[step].state - seen[step][0].state).max() for step in (0, 30, 100, 199)]
    assert errors[0] > 0.1
    assert errors[1] < 8e-3
    assert errors[2] < 1e-3
    assert errors[3] < 1e-4


@feedbacks
@pytest.mark.parametrize("wind", WINDS.values(), ids=WINDS.keys())
@pytest.mark.parametrize("reference", [HOVER, CIRCLE], ids=["hover", "circle"])
def test_constant_forces_are_found_and_told_apart(wind: list[float], rates: bool, reference: Reference) -> None:
    """On the quadrotor, the bob's horizontal one, and torque: to a millinewton in half a second, then exactly."""
    seen = flight(reference, tuple(wind), UNEQUAL)
    found = estimates(seen, QUICK, rates, UNEQUAL)
    for step, error in ((50, 1e-3), (100, 1e-5), (199, 1e-9)):
        assert_allclose(found[step].disturbance, np.tile(wind, (2, 1)), atol=error)
    assert_allclose(found[-1].state, seen[-1][0].state, atol=1e-10)


@every_gain
@feedbacks
def test_the_controllers_own_gains_find_them_too(gains: EstimatorGains, rates: bool) -> None:
    """What they do not know after 2 s is less than a fiftieth of what blows."""
    seen = flight(CIRCLE, tuple(WINDS["all"]))
    last = estimates(seen, gains, rates)[-1].disturbance
    assert_allclose(last, np.tile(WINDS["all"], (2, 1)), atol=0.02 * 0.4)


def test_the_bobs_vertical_force_counts_as_the_quadrotors() -> None:
    seen = flight(HOVER, (0.0, 0.0, 0.1, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    last = estimates(seen, QUICK, rates=True)[-1].disturbance
    assert_allclose(last, np.tile([0.0, 0.0, 0.3, *np.zeros(6)], (2, 1)), atol=5e-3)
    assert_array_equal(last[:, 5], 0.0)


@feedbacks
@pytest.mark.parametrize("angle", [0.5, np.pi / 2, 3.0])
def test_a_turned_world_is_seen_turned(angle: float, rates: bool) -> None:
    seen, turned = flight(CIRCLE, tuple(WINDS["all"])), []
    for measurement, command in seen:
        yaw = measurement.yaw_reference + np.array([angle, 0.0, 0.0])
        state, reference = rotate_states(measurement.state, angle), rotate_vectors(measurement.reference, angle)
        turned.append((Measurement(state, reference, yaw), command))
    plain, other = estimates(seen, QUICK, rates), estimates(turned, QUICK, rates)
    for one, two in zip(plain[::10], other[::10], strict=True):
        assert_allclose(two.state, rotate_states(one.state, angle), atol=1e-9)
        forces = rotate_vectors(one.disturbance.reshape(-1, 3, 3)[:, :2], angle)
        assert_allclose(two.disturbance[:, :6], forces.reshape(-1, 6), atol=1e-9)
        assert_allclose(two.disturbance[:, 6:], one.disturbance[:, 6:], atol=1e-9)


def plant(gains: EstimatorGains, rates: bool) -> tuple[Floats, Floats, Floats, Floats]:
    """Transition and measurement of state and forces, and the variances of their walk and of the noise."""
    simulation, size = Simulation(), MODEL_STATE_SIZE + DISTURBANCE_COLUMNS.size
    model = linearise(simulation)
    transition = np.block([[model.transition, model.disturbance], [np.zeros((8, MODEL_STATE_SIZE)), np.eye(8)]])
    walk = np.diag([gains.force_walk] * 3 + [gains.bob_force_walk] * 2 + [gains.torque_walk] * 3)
    process = np.zeros((size, size))
    process[MODEL_STATE_SIZE:, MODEL_STATE_SIZE:] = simulation.period * walk**2
    is_rate = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 1, 1], np.bool_)
    noise = np.where(is_rate, gains.rate_noise, gains.noise) ** 2
    seen = np.full(MODEL_STATE_SIZE, True) if rates else ~is_rate
    return transition, np.eye(size)[:MODEL_STATE_SIZE][seen], process, np.diag(noise[seen])


@every_gain
@feedbacks
def test_the_gain_becomes_that_of_the_steady_kalman_filter_and_is_stable(gains: EstimatorGains, rates: bool) -> None:
    """Against scipy's Riccati equation, to a tenth; all poles of the estimation error lie within the unit circle."""
    transition, measure, process, noise = plant(gains, rates)
    covariance = solve_discrete_are(transition.T, measure.T, process, noise)
    steady = covariance @ measure.T @ np.linalg.inv(measure @ covariance @ measure.T + noise)
    gain = estimator.gain_table(gains, Simulation(), rates)[-1]
    assert np.linalg.norm(gain - steady) < 0.1 * np.linalg.norm(steady)
    error = (np.eye(len(transition)) - gain @ measure) @ transition
    assert np.abs(np.linalg.eigvals(error)).max() < 0.99


def test_its_first_gains_are_those_of_one_who_knows_no_wind_and_no_rates() -> None:
    """At first a rate is corrected by what its position has moved in a period, and later by less."""
    gains = estimator.gain_table(QUICK, Simulation(), False)
    period, velocity_of_position = Simulation().period, gains[:, 3, 0]
    # Known to 1 mm, it goes on by 0.1 m/s · 0.01 s, and is measured to 1 mm: a third of the surprise is the rate's.
    assert velocity_of_position[0] == pytest.approx(1.0 / (3.0 * period), rel=0.05)
    assert velocity_of_position[0] > 2.0 * velocity_of_position[-1]


@feedbacks
def test_rows_are_seen_each_for_itself_and_only_the_returned_memory_counts(rates: bool) -> None:
    seen = flight(CIRCLE, tuple(WINDS["all"]))
    both = estimates(seen[:20], QUICK, rates)
    for row in range(2):
        i = slice(row, row + 1)
        alone = [(Measurement(*(part[i] for part in measurement)), command[i]) for measurement, command in seen[:20]]
        last = estimates(alone, QUICK, rates)[-1]
        assert_allclose(last.state, both[-1].state[i], atol=1e-13)
        assert_allclose(last.disturbance, both[-1].disturbance[i], atol=1e-13)
    again = estimates(seen[:20], QUICK, rates)
    for one, two in zip(again[-1], both[-1], strict=True):
        assert_array_equal(one, two)


def test_the_pendulums_direction_stays_a_direction() -> None:
    """Whatever is measured: unit length, above the horizon, and its rate along the sphere."""
    observer = Estimator(QUICK, Simulation())
    rng = np.random.default_rng(11)
    measurement = measurement_of(tilted_pendulum(rng.uniform(0.0, 1.4, 50), rng.uniform(0.0, 7.0, 50), 50))
    estimate = observer.initial_estimate(measurement)
    for _ in range(5):
        tilted = tilted_pendulum(rng.uniform(0.0, 1.4, 50), rng.uniform(0.0, 7.0, 50), 50)
        State(tilted).direction_rate[:] = rng.normal(size=(50, 3))
        hover = np.tile([PAPER.hover_thrust, 0.0, 0.0, 0.0], (50, 1))
        estimate = observer.update(estimate, hover, measurement_of(tilted))
        s = State(estimate.state)
        assert_allclose(np.linalg.norm(s.direction, axis=1), 1.0, rtol=1e-12)
        assert_allclose(np.sum(s.direction * s.direction_rate, axis=1), 0.0, atol=1e-12)
        assert (s.direction[:, 2] > 0.3).all()
