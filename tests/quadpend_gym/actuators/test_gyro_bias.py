"""The bias of the on-board gyro: constant in an episode, normal between episodes, and followed by the rate loop."""

from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from scipy import stats

from quadpend_gym import Simulation
from quadpend_gym.actuators import GyroBias, PacketLoss
from quadpend_gym.wrappers import ActuatorWrapper
from tests.helpers.envs import AT_REST, ENDLESS, assert_same, make_unwrapped
from tests.helpers.wrappers import SHORT, biased_actions, make_sync_vec, make_wrapped_vec
from tests.quadpend_gym.actuators.test_actuators import apply_actuators
from tests.quadpend_gym.envs.test_vector_env import assert_same_info

HUMMINGBIRD: dict[str, Any] = {"vehicle": "hummingbird", "interface": "body_rates"}


def test_a_gyro_bias_shifts_the_commanded_rates_of_an_episode() -> None:
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 2000, 4))
    shift = apply_actuators(GyroBias(0.1), actions, Simulation(**HUMMINGBIRD)) - actions
    assert not shift[..., 0].any()
    assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-15)
    rates = shift[0, :, 1:] * [10.0, 10.0, 3.0]  # rad/s at an action of 1
    for axis in rates.T:
        assert stats.kstest(axis / 0.1, "norm").pvalue > 0.001
    assert np.abs(np.corrcoef(rates, rowvar=False) - np.eye(3)).max() < 5.0 / np.sqrt(2000)


def test_a_biased_action_stays_in_its_range() -> None:
    out = apply_actuators(GyroBias(30.0), np.ones((1, 100, 4)), Simulation(**HUMMINGBIRD))
    assert np.abs(out).max() == 1.0


def test_the_rate_loop_turns_the_vehicle_by_the_bias() -> None:
    env: Any = ActuatorWrapper(make_unwrapped(task=ENDLESS, **HUMMINGBIRD), GyroBias(0.2))
    env.reset(seed=0, options={"state": AT_REST})
    for _ in range(10):
        env.step(np.zeros(4, np.float32))
    (bias,) = env.unwrapped.world._actuators._memories[0]
    assert_allclose(env.unwrapped.state.euler_rate[:2], -bias[:2], rtol=0.1)  # body rates, at a small tilt
    assert np.abs(bias).min() > 0.01


def test_rows_with_a_gyro_bias_and_lost_commands_equal_single_environments() -> None:
    layers = [("ActuatorWrapper", [PacketLoss(0.2), GyroBias(0.5)])]
    arguments = {**SHORT, **HUMMINGBIRD}
    env = make_wrapped_vec(3, layers, autoreset_mode="SameStep", **arguments)
    theirs = make_sync_vec(3, layers, "SameStep", **arguments)
    assert_same(env.reset(seed=9)[0], theirs.reset(seed=9)[0])
    ended = 0
    for actions in biased_actions(45, 3):
        *returned, info = env.step(actions)
        *expected, their_info = theirs.step(actions)
        assert_same(returned, expected)
        assert_same_info(info, their_info, np.ones(3, np.bool_))
        ended += int((returned[2] | returned[3]).sum())
    assert ended >= 6
