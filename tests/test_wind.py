"""Wind: every model obeys its equation, and blows the same however it is attached."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from quadpend_gym import PAPER, Constant, OrnsteinUhlenbeck, PaperGusts, Sinusoid, Task
from quadpend_gym.arrays import Floats, Integers
from quadpend_gym.dynamics import momentum
from quadpend_gym.kernel import advance
from quadpend_gym.models import Process
from quadpend_gym.streams import Streams
from quadpend_gym.wind import Sum, Wind, as_wind
from quadpend_gym.wrappers import VectorWindWrapper, WindWrapper
from tests.env_helpers import ENDLESS, WINDY, assert_same, draw_actions, fly, make, make_bare, make_rows

PERIOD = 0.01


def blown(wind: Any, steps: int, rows: int, period: float = PERIOD) -> Floats:
    """What acts in each step of an episode, shape (steps, rows, 9)."""
    process = Process(as_wind(wind), rows)
    out = np.zeros((steps, 12, rows)).swapaxes(1, 2)
    step = np.zeros(rows, np.int64)
    streams = Streams.from_seeds(list(range(rows)))
    process.begin(np.arange(rows), streams, lambda model, *rest: model.blow(out[0], rest[0], step, period, rest[1]))
    for k in range(1, steps):
        process.work(lambda model, *rest, k=k: model.blow(out[k], rest[0], step + k, period, rest[1]))
    return out


def test_a_constant_wind_is_constant() -> None:
    wind = Constant(force=(1.0, 2.0, 3.0), bob_force=(0.0, 0.0, -0.5), torque=0.25)
    assert_array_equal(blown(wind, 20, 3), np.broadcast_to((1, 2, 3, 0, 0, -0.5, 0.25, 0.25, 0.25), (20, 3, 9)))


def test_a_sinusoid_has_its_amplitude_frequency_and_a_random_phase() -> None:
    amplitude, frequency = 0.7, 3.0
    force = blown(Sinusoid(force=(amplitude, 0.0, 0.0), frequency=frequency), 400, 2000)[..., 0]
    # sin is the solution of d_{k+1} + d_{k−1} = 2 cos(ωT) d_k …
    cosine = np.cos(frequency * PERIOD)
    assert_allclose(force[2:] + force[:-2], 2.0 * cosine * force[1:-1], atol=1e-12)
    # … with this invariant, from which its amplitude follows.
    invariant = force[1:] ** 2 + force[:-1] ** 2 - 2.0 * cosine * force[1:] * force[:-1]
    assert_allclose(invariant, (amplitude * np.sin(frequency * PERIOD)) ** 2, rtol=1e-9)
    # The sine of a uniform phase is distributed by the arcsine law.
    assert stats.kstest(force[0], stats.arcsine(-amplitude, 2.0 * amplitude).cdf).pvalue > 0.01


def test_the_axes_of_a_sinusoid_have_phases_of_their_own() -> None:
    force = blown(Sinusoid(force=1.0), 1, 2000)[0, :, :3]
    assert np.abs(np.corrcoef(force.T) - np.eye(3)).max() < 0.08


@pytest.mark.parametrize(("period", "steps"), [(0.1, 21), (0.01, 101), (0.002, 501)])
def test_an_ornstein_uhlenbeck_wind_has_its_deviation_and_correlation_at_every_step_size(
    period: float, steps: int
) -> None:
    deviation, time_constant, rows = 0.4, 0.5, 10_000
    wind = OrnsteinUhlenbeck(force=(0.0, deviation, 0.0), time_constant=time_constant)
    force = blown(wind, steps, rows, period)[..., 1]
    assert_allclose(force.std(axis=1), deviation, rtol=0.04)
    assert_allclose(force.mean(axis=1), 0.0, atol=0.04 * deviation)
    for time in (period, 0.1, 0.5, 1.0):
        lag = round(time / period)
        correlation = np.corrcoef(force[0], force[lag])[0, 1]
        assert_allclose(correlation, np.exp(-time / time_constant), atol=0.04)
    assert stats.kstest(force[0] / deviation, "norm").pvalue > 0.01
    assert stats.kstest(force[-1] / deviation, "norm").pvalue > 0.01


def test_the_axes_of_an_ornstein_uhlenbeck_wind_are_independent() -> None:
    last = blown(OrnsteinUhlenbeck(force=1.0, bob_force=1.0, torque=1.0), 20, 5000)[-1]
    assert np.abs(np.corrcoef(last.T) - np.eye(9)).max() < 0.06


def test_gusts_are_nothing_before_their_onset_and_bounded_and_smooth_after() -> None:
    amplitude, hold = np.array([0.3, 0.2, 0.1, 0.05]), 0.5
    wind = PaperGusts(force=(0.3, 0.2, 0.1), yaw_torque=0.05, onset=1.0, hold=hold)
    out = blown(wind, 600, 200)
    gusts = out[..., [0, 1, 2, 8]]
    assert_array_equal(out[:100], 0.0)
    assert_array_equal(out[..., 3:8], 0.0)
    assert (np.abs(gusts) <= amplitude).all()
    assert (np.abs(gusts[150:]).max(axis=(0, 1)) > 0.98 * amplitude).all()
    # Half a cosine between targets at most 2 amplitudes apart.
    assert (np.abs(np.diff(gusts, axis=0)) <= np.pi * amplitude * PERIOD / hold).all()
    # At the end of each hold the target is reached, and the targets are uniform.
    targets = 0.5 * (gusts[149:-1:50] + gusts[150::50]) / amplitude
    assert stats.kstest(targets.ravel(), stats.uniform(-1.0, 2.0).cdf).pvalue > 0.01


def test_gusts_of_the_paper_set_in_after_ten_seconds() -> None:
    out = blown(PaperGusts(), 1010, 5)
    assert_array_equal(out[:1000], 0.0)
    assert (out[1005][:, [0, 1, 2, 8]] != 0.0).all()


def test_a_sum_is_the_sum_of_its_members() -> None:
    one, other = OrnsteinUhlenbeck(force=0.5), Constant(force=1.0, torque=0.1)
    assert_allclose(blown(one + other, 50, 4), blown(one, 50, 4) + blown(other, 50, 4), rtol=1e-15)
    assert_same(blown(one + other, 50, 4), blown(Sum((one, other)), 50, 4))
    assert_same(blown(one + (other + other), 50, 4), blown(one + other + other, 50, 4))


def test_adding_a_model_leaves_the_numbers_of_the_others_alone() -> None:
    first, added = OrnsteinUhlenbeck(force=0.5) + Sinusoid(bob_force=0.5), OrnsteinUhlenbeck(force=0.0, torque=0.1)
    assert_array_equal(blown(first + added, 50, 4)[..., :6], blown(first, 50, 4)[..., :6])


def test_equal_models_in_a_sum_blow_independently() -> None:
    wind = OrnsteinUhlenbeck(force=0.5)
    assert_allclose(blown(wind + wind, 1, 5000).std(axis=1)[0, :3], 0.5 * np.sqrt(2.0), rtol=0.04)


def test_every_row_and_every_episode_has_a_wind_of_its_own() -> None:
    env = make_rows(3, wind=WINDY)
    seen = []
    for seed in (0, None, None):
        env.reset(seed=seed)
        seen += list(env.step(np.zeros((3, 4)))[4]["disturbance"][:, 0])
    assert len(set(seen)) == 9


@pytest.mark.parametrize(
    "wind",
    [Constant(force=0.5), Sinusoid(torque=0.05), OrnsteinUhlenbeck(), PaperGusts(onset=0.02), WINDY],
    ids=["constant", "sinusoid", "ornstein_uhlenbeck", "paper_gusts", "sum"],
)
def test_keyword_and_wrapper_blow_the_same_for_one_and_for_many(wind: Any) -> None:
    actions = draw_actions(0, 20)
    flights = [
        [env.reset(seed=3)[0], *(step[:2] for step in fly(env, actions))]
        for env in (make(wind=wind), WindWrapper(make(), wind))
    ]
    for rows in (make_rows(4, wind=wind), VectorWindWrapper(make_rows(4), wind)):
        first = rows.reset(seed=0)[0][3]
        flight = fly(rows, np.repeat(actions[:, np.newaxis], 4, axis=1))
        flights.append([first, *((step[0][3], step[1][3]) for step in flight)])
    for flight in flights[1:]:
        assert_same(flight, flights[0])


def test_a_wrapper_blows_besides_what_blows_already() -> None:
    wrapped, summed = WindWrapper(make(wind=Constant(force=1.0)), WINDY), make(wind=Constant(force=1.0) + WINDY)
    wrapped.reset(seed=0), summed.reset(seed=0)
    actions = draw_actions(0, 10)
    assert_same(fly(wrapped, actions), fly(summed, actions))


@dataclass(frozen=True)
class Ramp:
    """A model of a user's own: a force in x that grows from a random number with time."""

    slope: float = 1.0
    memory_size: int = 1

    def start(self, streams: Streams) -> Floats:
        """A random first force."""
        return streams.uniform(np.zeros(streams.keys.size, np.int64), 1)

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The force, which grows."""
        out[:, 0] += memory[:, 0]
        memory[:, 0] += self.slope * period


def test_a_model_of_ones_own_in_plain_numpy_blows() -> None:
    assert isinstance(Ramp(), Wind)
    env, rows = make_bare(wind=Ramp()), make_rows(3, wind=Sum((Ramp(), Constant(torque=0.1))))
    env.reset(seed=2), rows.reset(seed=0)
    single = [step[4]["disturbance"] for step in fly(env, np.zeros((10, 4)))]
    many = [step[4]["disturbance"][2] for step in fly(rows, np.zeros((10, 3, 4)))]
    assert_allclose(np.diff([disturbance[0] for disturbance in single]), 0.01, rtol=1e-12)
    assert_array_equal([disturbance[0] for disturbance in many], [disturbance[0] for disturbance in single])


def test_the_disturbance_in_info_is_what_acted() -> None:
    """The state follows from the state before, the action and `info["disturbance"]`."""
    env = make_bare(wind=WINDY)
    env.reset(seed=0)
    parameters = PAPER.as_array()[np.newaxis]
    for action in draw_actions(0, 10):
        state = env.state.array[np.newaxis].copy()
        info = env.step(action)[4]
        command = np.array([[PAPER.hover_thrust, 5.0, 5.0, 1.0]]) * (action + np.eye(4)[0])
        advance(state, command, info["disturbance"][np.newaxis], parameters, PERIOD, 2)
        assert_allclose(env.state.array, state[0], atol=1e-14)


def test_forces_change_the_momentum_and_torques_the_spin_as_info_says() -> None:
    env = make_bare(task=ENDLESS, wind=WINDY)
    env.reset(seed=0)
    no_thrust = (-1.0, 0.0, 0.0, 0.0)
    for _ in range(10):
        before, spin = momentum(env.state.array, PAPER), env.state.euler_rate.copy()
        disturbance = env.step(no_thrust)[4]["disturbance"]
        force = disturbance[0:3] + disturbance[3:6] - (0.0, 0.0, PAPER.hover_thrust)
        assert_allclose(momentum(env.state.array, PAPER) - before, PERIOD * force, rtol=1e-9)
        assert_allclose(env.state.euler_rate - spin, PERIOD * disturbance[6:9] / PAPER.inertia_roll, rtol=1e-9)


def test_no_wind_blows_at_a_reset() -> None:
    assert_array_equal(make(wind=WINDY).reset(seed=0)[1]["disturbance"], 0.0)


def test_calm_and_a_sum_of_nothing_are_the_same() -> None:
    actions = draw_actions(0, 5)
    calm, empty = make_bare(task=Task()), make_bare(task=Task(), wind=Sum())
    assert_same((calm.reset(seed=0), fly(calm, actions)), (empty.reset(seed=0), fly(empty, actions)))


def test_wind_that_is_not_a_number_is_refused_and_not_taken_for_a_crash() -> None:
    env = make_rows(3, wind=Ramp(slope=np.nan))
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    before = env.world.state.copy()
    with pytest.raises(ValueError, match=r"wind must blow finite numbers, not \[nan, 0.0, .*\] in row 0"):
        env.step(np.zeros((3, 4)))
    assert_array_equal(env.world.state, before)
