"""Sensor models: the sizes of their errors, delay and dropout, and that they do not change the true state."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from quadpend_gym import OBSERVATION_FIELDS, Reference, read_observation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import STATE_FIELDS, State
from quadpend_gym.sensors import PARTS, Bursts, Delay, Dropout, Frozen, Noise, Outliers, SampleHold
from tests.helpers.envs import ENDLESS, WINDY, assert_same, draw_actions, make_vec

MOVING = Reference(
    offset=(0.1, -0.2, 2.5, 0.3),
    rate=(0.0, 0.05, 0.1, 0.02),
    amplitude=(0.5, 0.4, 0.1, 0.2),
    frequency=(1.0, 2.0, 1.5, 0.7),
    phase=(0.1, 0.2, 0.3, 0.4),
)
PERIOD = 0.01
WHITE = {"position": 0.01, "velocity": 0.02, "euler": 0.03, "euler_rate": 0.04, "direction_rate": 0.05}  # not r
# One sensor of each kind of error, and several in one list.
SENSORS: dict[str, Any] = {
    "white noise": Noise(**WHITE, direction=0.02),
    "bias and walk": Noise(position={"bias": 0.05, "walk": 0.1}, direction={"bias": 0.02, "walk": 0.01}),
    "quantisation": Noise(position={"quantum": 0.01}, direction={"quantum": 0.01}),
    "delay": Delay(3),
    "dropout": Dropout(0.3),
    "bursts": Bursts((0.05, 0.1), (0.02, 0.06)),
    "frozen": Frozen((0.05, 0.1), (0.02, 0.06)),
    "frozen pole": Frozen((0.05, 0.1), (0.02, 0.06), parts=("pole",)),
    "outliers": Outliers((0.5, 1.0), (0.01, 0.02)),
    "outliers of the pole": Outliers(np.pi, (0.01, 0.02), "pole"),
    "outliers of the attitude": Outliers(np.pi, (0.01, 0.02), "attitude"),
    "sample and hold": SampleHold(0.07),  # 60 control steps end on a held sample
    "all": [Noise(position=0.01), Dropout(0.3), Delay(2), {"kind": "noise", "euler": {"quantum": 0.01}}],
}
every_sensor = pytest.mark.parametrize("sensors", SENSORS.values(), ids=SENSORS.keys())


def true_and_measured(sensors: Any, rows: int, steps: int, **kwargs: Any) -> tuple[Floats, Floats]:
    """Return true and measured states from a reset on, each of shape (steps + 1, rows, 18)."""
    env = make_vec(rows, **{"task": ENDLESS, "sensors": sensors, **kwargs})
    world = env.world
    env.reset(seed=0)
    states = [(world.state.copy(), world.measured.copy())]
    for action in draw_actions(0, steps, rows):
        env.step(action)
        states.append((world.state.copy(), world.measured.copy()))
    true, measured = np.array(states).swapaxes(0, 1)
    return true, measured


def errors(sensors: Any, rows: int, steps: int, **kwargs: Any) -> Floats:
    """Return the measurement errors, shape (steps + 1, rows, 18)."""
    true, measured = true_and_measured(sensors, rows, steps, **kwargs)
    return measured - true


def largest_correlation(one: Floats, other: Floats) -> float:
    """Return the largest absolute correlation between columns of two arrays of shape (n, k), in units of 1/√n."""
    n, k = one.shape
    correlations = np.corrcoef(one, other, rowvar=False)[:k, k:]
    return float(np.abs(correlations).max() * np.sqrt(n))


def test_white_noise_is_normal_with_the_given_standard_deviation() -> None:
    error = errors(Noise(**WHITE), 500, 100).reshape(-1, 18)
    for name, deviation in WHITE.items():
        for component in error[:, STATE_FIELDS[name]].T:
            assert stats.kstest(component / deviation, "norm").pvalue > 0.001
            # The relative standard error of a standard deviation estimated from n samples is 1/√(2n).
            assert np.std(component) == pytest.approx(deviation, rel=5.0 / np.sqrt(2 * component.size))
    assert not error[:, STATE_FIELDS["direction"]].any()


def test_a_noisy_direction_is_a_unit_vector_with_an_angular_error_of_the_given_size() -> None:
    deviation = 0.01
    true, measured = (
        State(states.reshape(-1, 18)) for states in true_and_measured(Noise(direction=deviation), 300, 100)
    )
    assert_allclose(np.linalg.norm(measured.direction, axis=-1), 1.0, rtol=1e-15)
    sine = np.linalg.norm(np.cross(true.direction, measured.direction), axis=-1)
    # The error is normal in each of two perpendicular directions, so the angle has a Rayleigh distribution.
    assert stats.kstest(np.arcsin(sine) / deviation, "rayleigh").pvalue > 0.001


def test_the_observation_is_computed_from_the_measured_state_and_the_present_reference() -> None:
    """The observation uses the true length of the rod."""
    rows = 4
    sensors = SENSORS["all"] + [SENSORS["white noise"], SENSORS["bias and walk"]]
    env = make_vec(rows, task=ENDLESS, parameters={"rod_length": (0.2, 0.5)}, sensors=sensors)
    env.reset(seed=3, options={"reference": MOVING})
    for step, action in enumerate(draw_actions(0, 20, rows), 1):
        observation, *_, info = env.step(action)
        should = MOVING.derivatives(PERIOD * step)
        measured = State(env.world.measured)
        rod = info["parameters"][:, 2:3] * [1.0, 1.0, 0.0]  # the tracking error in z is that of the quadrotor
        expected = {
            "tracking_error": measured.position + rod * measured.direction - should[0, :3],
            "tracking_error_rate": measured.velocity + rod * measured.direction_rate - should[1, :3],
            "direction": measured.direction,
            "direction_rate": measured.direction_rate,
            "attitude": measured.euler - [0.0, 0.0, should[0, 3]],
            "euler_rate": measured.euler_rate,
            **{f"reference_{order}": np.tile(should[order, :3], (rows, 1)) for order in range(2, 7)},
            "yaw_reference": np.tile(should[:3, 3], (rows, 1)),
        }
        assert expected.keys() == OBSERVATION_FIELDS.keys()
        for name, value in expected.items():
            assert_allclose(read_observation(observation, name), value, rtol=1e-6, atol=1e-7)


def test_a_bias_is_constant_within_an_episode_and_normal_between_episodes() -> None:
    rows, place = 1000, STATE_FIELDS["velocity"]
    error = errors(Noise(velocity={"bias": 0.1}), rows, 39, autoreset_mode="SameStep", duration=0.2)
    first, second = error[:20, :, place], error[20:, :, place]
    for episode in (first, second):
        assert_allclose(episode, np.broadcast_to(episode[0], episode.shape), atol=1e-12)
        assert stats.kstest(episode[0].ravel() / 0.1, "norm").pvalue > 0.001
    assert largest_correlation(first[0], second[0]) < 5.0
    assert not error[:, :, STATE_FIELDS["position"]].any()


@pytest.mark.parametrize("period", [0.005, 0.02])
def test_the_variance_of_a_random_walk_does_not_depend_on_the_control_period(period: float) -> None:
    rows, walk = 2000, 0.3
    times = np.array([0.0, 0.1, 0.3, 0.4])
    error = errors(Noise(position={"walk": walk}), rows, round(times[-1] / period), period=period)
    error = error[np.round(times / period).astype(int)][:, :, STATE_FIELDS["position"]]
    assert_allclose(np.var(error, axis=(1, 2)), walk**2 * times, rtol=5.0 * np.sqrt(2 / (3 * rows)))
    assert largest_correlation(error[1], error[2] - error[1]) < 5.0
    assert largest_correlation(error[2] - error[1], error[3] - error[2]) < 5.0


def test_quantisation_is_applied_after_the_noise() -> None:
    quantum = 2.0**-7
    coarse = {"white": 0.01, "bias": 0.1, "quantum": quantum}
    true, measured = true_and_measured(Noise(position=coarse, euler=coarse, direction={"quantum": quantum}), 50, 20)
    for name in ("position", "euler", "direction"):
        assert not (measured[:, :, STATE_FIELDS[name]] % quantum).any()
    assert np.abs(measured - true)[:, :, STATE_FIELDS["direction"]].max() <= quantum / 2
    untouched = STATE_FIELDS["velocity"]
    assert_array_equal(measured[:, :, untouched], true[:, :, untouched])


@pytest.mark.parametrize(("steps", "mode"), [(3, "NextStep"), (12, "SameStep")])
def test_a_delayed_measurement_equals_the_earlier_one_exactly(steps: int, mode: str) -> None:
    """During the first steps it is the measurement of the reset, never one of the previous episode."""
    env = make_vec(5, autoreset_mode=mode, duration=0.09, sensors=Delay(steps))
    env.reset(seed=0)
    world = env.world
    episodes: list[list[Floats]] = [[state] for state in world.state.copy()]
    for action in draw_actions(0, 40, 5):
        env.step(action)
        for row, state in enumerate(world.state.copy()):
            if world.clock[row] == 0:
                episodes[row] = []
            episodes[row].append(state)
            assert_array_equal(world.measured[row], episodes[row][max(len(episodes[row]) - 1 - steps, 0)])
    assert world.episode.min() >= 3


def test_noise_before_a_delay_is_delayed_and_noise_after_it_is_not() -> None:
    noise = Noise(position=0.1)
    _, noisy = true_and_measured(noise, 3, 20)
    _, noisy_then_late = true_and_measured([noise, Delay(4)], 3, 20)
    _, late_then_noisy = true_and_measured([Delay(4), noise], 3, 20)
    assert_array_equal(noisy_then_late[4:], noisy[:-4])
    assert_array_equal(noisy_then_late[:5], np.broadcast_to(noisy[0], (5, 3, 18)))
    assert len(np.unique(late_then_noisy[:5, 0, 0])) == 5


def test_dropout_loses_the_given_fraction_independently_in_each_sub_environment() -> None:
    true, measured = true_and_measured(Dropout(0.3), 400, 100)
    received = (measured == true).all(axis=-1)
    assert received[0].all()
    assert_array_equal(measured[1:][~received[1:]], measured[:-1][~received[1:]])
    lost = ~received[1:]
    assert lost.mean() == pytest.approx(0.3, abs=5.0 * np.sqrt(0.3 * 0.7 / lost.size))
    for one, other in ((lost[1:], lost[:-1]), (lost[:, 1:], lost[:, :-1])):
        assert largest_correlation(one.reshape(-1, 1), other.reshape(-1, 1)) < 5.0


def ages(sensors: Any, rows: int, steps: int) -> Floats:
    """Return the observed ages of the samples from a reset on, shape (steps + 1, rows), s."""
    env = make_vec(rows, task=ENDLESS, sensors=sensors, observation=["age"])
    observed = [env.reset(seed=0)[0], *(env.step(action)[0] for action in draw_actions(0, steps, rows))]
    return np.array([read_observation(item, "age", ["age"])[:, 0] for item in observed])


def test_the_age_of_a_sample_is_the_time_since_it_was_new() -> None:
    """It begins at 0 in every episode, a delay delays it with its sample, and it is given on to the next sensor."""
    numbers = np.arange(41)
    assert not ages([Noise(position=0.1), Delay(3), Outliers(pause=(0.01, 0.01))], 3, 40).any()
    assert_allclose(ages(SampleHold(0.05), 2, 40)[:, 1], 0.01 * (numbers % 5), atol=1e-7)
    assert_allclose(ages([SampleHold(0.05), Delay(2)], 2, 40)[2:, 1], 0.01 * (numbers[:-2] % 5), atol=1e-7)
    assert_allclose(ages(Dropout(1.0), 2, 40)[:, 1], 0.01 * numbers, atol=1e-6)


def test_bursts_and_frozen_samples_hold_the_last_one_for_their_length() -> None:
    """With a pause of 0.2 s and a length of 0.1 s, steps 20 to 29 have the sample of step 19, and so on."""
    pause, length = (0.2, 0.2), (0.1, 0.1)
    number = np.arange(101)
    held = number % 30 >= 20
    source = np.where(held, number // 30 * 30 + 19, number)
    for kind, ageing in ((Bursts, 0.01), (Frozen, 0.0)):
        true, measured = true_and_measured(kind(length, pause), 3, 100)
        assert_array_equal(measured, true[source])
        assert_allclose(ages(kind(length, pause), 3, 100)[:, 2], ageing * (number - source), atol=1e-6)
    lost = ages(Bursts((0.05, 0.15), (0.3, 0.9)), 400, 300) > 0.0
    assert not lost[0].any()
    assert lost[100:].mean() == pytest.approx(0.1 / 0.7, rel=0.1)
    assert largest_correlation(lost[200, :-1, np.newaxis], lost[200, 1:, np.newaxis]) < 5.0


def test_an_outlier_moves_the_position_of_one_sample_in_a_random_direction() -> None:
    error = errors(Outliers(0.5, (0.2, 0.2)), 1000, 50)
    hit = (error != 0.0).any(axis=-1)
    assert_array_equal(hit, np.broadcast_to(np.isin(np.arange(51), (20, 40))[:, np.newaxis], hit.shape))
    position = error[20, :, STATE_FIELDS["position"]]
    assert_array_equal(np.delete(error, STATE_FIELDS["position"], axis=-1), 0.0)
    assert_allclose(np.linalg.norm(position, axis=-1), 0.5, rtol=1e-12)
    for component in position.T:  # each component of a uniform direction is uniform
        assert stats.kstest(component / 0.5, stats.uniform(-1.0, 2.0).cdf).pvalue > 0.001
    size = np.linalg.norm(errors(Outliers((0.5, 1.5), (0.01, 0.01)), 1000, 1)[1], axis=-1)
    assert stats.kstest(size, stats.uniform(0.5, 1.0).cdf).pvalue > 0.001


@pytest.mark.parametrize("part", PARTS)
def test_outliers_and_frozen_samples_of_a_part_leave_the_others_alone(part: Any) -> None:
    """The pole of an outlier is at its angle from the true one, by π in the opposite direction."""
    number, columns = np.arange(31), PARTS[part]
    true, measured = true_and_measured(Frozen((0.1, 0.1), (0.2, 0.2), parts=(part,)), 3, 30)
    assert_array_equal(measured[:, :, columns], true[np.where(number // 10 == 2, 19, number)][:, :, columns])
    assert_array_equal(np.delete(measured, columns, axis=-1), np.delete(true, columns, axis=-1))
    size = np.pi if part == "pole" else 0.5
    true, measured = true_and_measured(Outliers(size, (0.2, 0.2), part), 3, 30)
    first = slice(columns.start, columns.start + 3)
    assert_array_equal(np.delete(measured, first, axis=-1), np.delete(true, first, axis=-1))
    assert_array_equal(np.delete(measured, 20, axis=0), np.delete(true, 20, axis=0))
    right, wrong = true[20, :, first], measured[20, :, first]
    assert_allclose(
        wrong if part == "pole" else np.linalg.norm(wrong - right, axis=-1), -right if part == "pole" else size
    )
    angle = errors(Outliers(0.5, (0.01, 0.01), "pole"), 100, 1)[1, :, PARTS["pole"]][:, :3]
    assert_allclose(np.linalg.norm(angle, axis=-1), 2.0 * np.sin(0.25), rtol=1e-12)


@every_sensor
def test_what_an_episode_measures_does_not_depend_on_other_rows(sensors: Any) -> None:
    found = []
    for rows, seed in ((5, 0), (1, 3)):
        env = make_vec(rows, sensors=sensors, duration=0.25, autoreset_mode="SameStep", observation="lab")
        observed = [env.reset(seed=seed)[0], *(env.step(np.zeros((rows, 4), np.float32))[0] for _ in range(60))]
        found.append(np.array(observed)[:, 3 if rows == 5 else 0])
    assert_array_equal(*found)


@pytest.mark.parametrize(("period", "steps"), [(0.03, 3), (0.01, 1), (0.002, 1)])
def test_a_slow_sensor_holds_its_last_sample(period: float, steps: int) -> None:
    true, measured = true_and_measured(SampleHold(period), 3, 20)
    assert_array_equal(measured, true[np.arange(21) // steps * steps])


@every_sensor
def test_sensors_do_not_change_the_true_state(sensors: Any) -> None:
    """States, rewards, episode ends, `info` and wind are equal to the last bit; observations are not."""
    plain, sensed = (make_vec(5, wind=WINDY, duration=0.25, sensors=own) for own in (None, sensors))
    assert_same(sensed.reset(seed=0)[1], plain.reset(seed=0)[1])
    for action in draw_actions(0, 60, 5):
        observed, *rest = sensed.step(action)
        observation, *expected = plain.step(action)
        assert_same(rest, expected)
        assert_array_equal(sensed.world.state, plain.world.state)
        assert_array_equal(sensed.world.wind, plain.world.wind)
    assert (observed[:, :18] != observation[:, :18]).any()
    assert_array_equal(observed[:, 18:], observation[:, 18:])  # the reference is known


def test_the_level_of_noise_is_drawn_for_each_episode() -> None:
    """It multiplies every size: a level of 2 doubles them, to the last bit, and the level of a row is its own."""
    sizes = {"white": 0.01, "bias": 0.02, "walk": 0.03, "quantum": 0.005}
    doubled = {name: 2.0 * size for name, size in sizes.items()}
    single, double = (
        true_and_measured(Noise(position=own, direction=own, level=level), 5, 20)
        for own, level in ((doubled, None), (sizes, (2.0, 2.0)))
    )
    assert_same(single, double)
    found = errors(Noise(position=0.01, level=(0.5, 2.0)), 300, 100)[:, :, :3].std(axis=(0, 2)) / 0.01
    assert stats.kstest((found - 0.5) / 1.5, "uniform").pvalue > 0.001
    alone = errors(Noise(position=0.01, level=(0.5, 2.0)), 3, 100)[:, :, :3]
    assert_allclose(alone, errors(Noise(position=0.01, level=(0.5, 2.0)), 300, 100)[:, :3, :3], atol=1e-12)
