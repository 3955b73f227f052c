"""Actuator models: delay, lag, rate limit, packet loss and gyro bias, and the order in which they act."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from scipy.integrate import solve_ivp

from quadpend_gym import PAPER, Simulation
from quadpend_gym.actuators import (
    ActionDelay,
    GyroBias,
    MotorLag,
    PacketBursts,
    PacketLoss,
    RateLimit,
    as_actuators,
)
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import Streams
from tests.helpers.envs import ENDLESS, WINDY, assert_same, draw_actions, make_unwrapped, make_vec, run_actions

PERIOD = Simulation().period
HUMMINGBIRD: dict[str, Any] = {"vehicle": "hummingbird", "interface": "body_rates"}
CHAINS: dict[str, Any] = {
    "delay": ActionDelay(3),
    "lag": MotorLag(0.02),
    "rate limit": RateLimit(30.0),
    "all": [ActionDelay(2), RateLimit(50.0), MotorLag(0.03)],
}
chains = pytest.mark.parametrize("actuators", CHAINS.values(), ids=CHAINS.keys())


def apply_actuators(actuators: Any, actions: Any, simulation: Simulation | None = None) -> Floats:
    """Return the result of actuators for the actions of an episode, both of shape (steps, rows, 4)."""
    steps, rows = actions.shape[:2]
    batch, simulation = ModelBatch(as_actuators(actuators), rows), simulation or Simulation()
    batch.start_episodes(np.arange(rows), Streams.from_seeds(list(range(rows))), lambda *_: None)
    out = np.zeros((steps, 4, rows)).swapaxes(1, 2)
    out[:] = actions
    for k in range(steps):
        batch.apply(lambda model, *rest, k=k: model.act(out[k], rest[0], np.full(rows, k), simulation, rest[1]))
    return out


def constant_actions(value: float, steps: int) -> Floats:
    """Return `steps` equal actions with equal components, shape (steps, 1, 4)."""
    return np.full((steps, 1, 4), value)


def without_commands(returned: list[Any]) -> list[Any]:
    """Remove the commands from the results of an environment, since only actuators add them to info."""
    for *_, info in returned:
        del info["command"]
        info.pop("_command", None)
    return returned


@chains
def test_an_episode_equals_one_with_the_actions_that_the_actuators_return(actuators: Any) -> None:
    """Physics, observation and reward, including the effort, are equal to the last bit."""
    env, plain = (make_vec(3, task=ENDLESS, wind=WINDY, actuators=own) for own in (actuators, None))
    actions = draw_actions(0, 40, 3)
    for seed in (0, None):  # the second episode does not depend on the first
        assert_same(without_commands([env.reset(seed=seed)]), [plain.reset(seed=seed)])
        changed = apply_actuators(actuators, actions).astype(np.float32)
        assert_same(without_commands(run_actions(env, actions)), run_actions(plain, changed))


def test_info_reports_thrust_and_torques() -> None:
    env = make_unwrapped(actuators=ActionDelay(1))
    hover = [PAPER.hover_thrust, 0.0, 0.0, 0.0]
    assert_allclose(env.reset(seed=0)[1]["command"], hover)
    first, second = (env.step(np.array([0.5, 0.1, -0.2, 0.3], np.float32))[4]["command"] for _ in range(2))
    assert_allclose(first, hover)
    assert_allclose(second, [1.5 * PAPER.hover_thrust, 0.5, -1.0, 0.3], rtol=1e-6)


def test_a_delay_shifts_the_actions_and_begins_with_hover() -> None:
    actions = draw_actions(0, 30, 2)
    assert_array_equal(apply_actuators(ActionDelay(7), actions), [*np.zeros((7, 2, 4)), *actions[:-7]])


@pytest.mark.parametrize("period", [0.005, 0.02])
@pytest.mark.parametrize("time_constant", [0.003, 0.05])
def test_a_motor_lag_solves_its_differential_equation(time_constant: float, period: float) -> None:
    """The result is the mean over each period of a numerical solution of T ẏ = a − y."""
    actions, y, means = draw_actions(0, 12, 1), np.zeros(4), []
    for action in actions[:, 0].astype(np.float64):

        def rates(_: float, values: Floats, a: Floats = action) -> Floats:
            return np.concatenate([(a - values[:4]) / time_constant, values[:4]])

        solution = solve_ivp(rates, (0.0, period), np.concatenate([y, np.zeros(4)]), rtol=1e-10, atol=1e-12)
        y, integral = np.split(solution.y[:, -1], 2)
        means.append(integral / period)
    lagged = apply_actuators(MotorLag(time_constant), actions, Simulation(period=period))
    assert_allclose(lagged[:, 0], means, atol=1e-8)


def test_a_rate_limit_bounds_the_slope_and_reaches_the_action() -> None:
    max_change = 12.0 * PERIOD
    actions = np.concatenate([draw_actions(0, 40, 5), constant_actions(0.9, 20) + np.zeros((20, 5, 4))])
    out = apply_actuators(RateLimit(12.0), actions)
    slopes = np.diff(out, axis=0, prepend=np.zeros((1, 5, 4)))  # from hover
    assert np.abs(slopes).max() <= max_change + 1e-15
    assert_allclose(out[-1], 0.9, rtol=1e-15)
    limited = np.abs(out - actions) > 1e-12
    assert_allclose(np.abs(slopes[limited]), max_change, rtol=1e-12)
    assert 0.2 < limited.mean() < 0.9


def test_a_lost_command_is_replaced_by_the_last_one_that_arrived() -> None:
    actions = draw_actions(0, 300, 20).astype(np.float64)
    out = apply_actuators(PacketLoss(0.2), actions)
    arrived = (out == actions).all(axis=-1)
    before = np.concatenate([np.zeros((1, 20, 4)), out[:-1]])  # hover before the first command
    assert_array_equal(out[~arrived], before[~arrived])
    assert (~arrived).mean() == pytest.approx(0.2, abs=5.0 * np.sqrt(0.2 * 0.8 / arrived.size))


def test_bursts_of_lost_commands_hold_the_last_one_for_their_length() -> None:
    """With a pause of 0.2 s and a length of 0.1 s, steps 20 to 29 have the action of step 19; at first it is hover."""
    actions, number = draw_actions(0, 100, 3), np.arange(100)
    out = apply_actuators(PacketBursts((0.1, 0.1), (0.2, 0.2)), actions)
    assert_array_equal(out, actions[np.where(number % 30 >= 20, number // 30 * 30 + 19, number)])
    assert not apply_actuators(PacketBursts((0.1, 0.1), (0.0, 0.0)), actions)[:10].any()


def test_a_gyro_bias_shifts_the_commanded_rates_of_an_episode() -> None:
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 2000, 4))
    shift = apply_actuators(GyroBias(0.1), actions, Simulation(**HUMMINGBIRD)) - actions
    assert not shift[..., 0].any()
    assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-15)
    rates = shift[0, :, 1:] * [10.0, 10.0, 3.0]  # rad/s at an action of 1
    for axis in rates.T:
        assert stats.kstest(axis / 0.1, "norm").pvalue > 0.001
    assert np.abs(np.corrcoef(rates, rowvar=False) - np.eye(3)).max() < 5.0 / np.sqrt(2000)


def test_actuators_act_in_the_order_of_the_list() -> None:
    actions, one, other = draw_actions(0, 30, 2), RateLimit(20.0), MotorLag(0.05)
    one_first, other_first = apply_actuators([one, other], actions), apply_actuators([other, one], actions)
    assert_array_equal(one_first, apply_actuators(other, apply_actuators(one, actions)))
    assert_array_equal(other_first, apply_actuators(one, apply_actuators(other, actions)))
