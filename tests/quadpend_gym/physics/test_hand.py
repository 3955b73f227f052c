"""A hand at the pole's upper end moves a rigid vehicle as in MuJoCo, and with an error of second order."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import Drawn, Hold, OrnsteinUhlenbeck, Rescaled, Scenario
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs.world import world_of
from quadpend_gym.vehicles import Vehicle
from quadpend_gym.wind import HAND
from quadpend_gym.wind.steady import Rising
from tests.helpers.envs import draw_actions
from tests.helpers.rigid import random_vehicle, start
from tests.helpers.rigid_mujoco import Engine, command_of
from tests.helpers.wind import PERIOD as WIND_PERIOD
from tests.helpers.wind import five_sigma, sample_wind

PERIOD, STEPS = 0.02, 15
HELD = Hold(20.0, 0.5, distance=0.3, point=(0.2, -0.1), until=0.2)


def held(vehicle: Vehicle, substeps: int, wind: Any = HELD) -> tuple[Any, Floats]:
    """Return the environment of one held vehicle after a reset, and the actions of its flight."""
    interface: Any = "wrench" if vehicle.rotors is None else "rotors"
    task = {"limits": {"body_angle": 1.57, "pendulum_angle": 3.0, "tracking_error": 50.0, "ground": -100.0}}
    scenario = Scenario(task, wind, vehicle, interface, period=PERIOD, substeps=substeps)
    env = scenario.make_vec(1)
    env.reset(seed=1)
    return env, 0.1 * draw_actions(0, STEPS)


def fly(vehicle: Vehicle, substeps: int, wind: Any = HELD) -> Floats:
    """Return the state after a flight that begins held and ends released, shape (18,)."""
    env, actions = held(vehicle, substeps, wind)
    for action in actions:
        assert not env.step(action[np.newaxis])[2].any()
    return np.array(world_of(env).state[0])


@pytest.mark.parametrize("with_rotors", [False, True], ids=["wrench", "rotors"])
def test_a_held_pole_moves_as_in_mujoco(with_rotors: bool) -> None:
    vehicle = random_vehicle(1, with_rotors)
    env, actions = held(vehicle, 40)
    world = world_of(env)
    hand, simulation = np.array(world._columns[HAND, 0]), world.simulation
    engine = Engine(start(simulation, world.state), 1e-4)
    at_end = np.array([0.0, 0.0, vehicle.pole.full_length])

    def pull(model: Any, data: Any) -> None:
        """Add the generalised force Jᵀ F of the force at the pole's upper end."""
        end, jacobian = data.xpos[2] + data.xmat[2].reshape(3, 3) @ at_end, np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, end, 2)
        force = hand[:2] - hand[2] * end[:2] - hand[3] * (jacobian @ data.qvel)[:2]
        data.qfrc_passive[:] += jacobian[:2].T @ force

    for step, action in enumerate(actions):
        mujoco.set_mjcb_passive(pull if PERIOD * step < HELD.until - 1e-6 else None)
        try:
            engine.advance(command_of(action, simulation), np.zeros(9), PERIOD)
        finally:
            mujoco.set_mjcb_passive(None)
        env.step(action[np.newaxis])
        s = world.state[0]
        assert_allclose(s[:3], engine.positions()[0], rtol=0.0, atol=2e-6)


def test_the_error_of_a_hand_is_of_second_order() -> None:
    vehicle, substeps = random_vehicle(1, with_rotors=True), np.array([16, 32, 64, 128])
    exact = fly(vehicle, 2000)
    errors = [np.abs(fly(vehicle, int(count)) - exact) for count in substeps]
    for first in (0, 3, 12, 15):  # position, velocity, direction and its rate
        largest = [error[first : first + 3].max() for error in errors]
        slope = np.polyfit(np.log(PERIOD / substeps), np.log(largest), 1)[0]
        assert slope == pytest.approx(2.0, abs=0.15)


def test_several_hands_pull_as_one_with_the_sum_of_their_stiffness_and_damping() -> None:
    vehicle = random_vehicle(1)
    both = [Hold(12.0, 0.2, distance=0.0, point=(0.5, 0.0)), Hold(4.0, 0.1, distance=0.0, point=(-0.3, 0.8))]
    one = Hold(16.0, 0.3, distance=0.0, point=(0.3, 0.2))
    assert_allclose(fly(vehicle, 4, both), fly(vehicle, 4, one), rtol=0.0, atol=1e-12)


def test_a_drawn_wind_scales_and_turns_its_hand_and_one_for_another_vehicle_does_not() -> None:
    wind = Hold(10.0, 0.5, distance=0.0, point=(2.0, 1.0))
    same, turned = Rescaled(wind, 0.5), Drawn(wind, (2.0, 2.0), (0.5 * np.pi, 0.5 * np.pi))
    found = [sample_wind(item, 1, 1, columns=HAND)[0, 0] for item in (wind, same, turned, Rising(wind, WIND_PERIOD))]
    assert_allclose(found, [[20, 10, 10, 0.5], [20, 10, 10, 0.5], [-20, 40, 20, 1.0], [10, 5, 5, 0.25]], atol=1e-14)


def test_a_hand_holds_at_its_distance_on_a_random_side_and_lets_go() -> None:
    out = sample_wind(Hold(20.0, 0.5, distance=0.05, until=0.1), 20, 500, columns=HAND)
    assert_array_equal(out[:10], np.broadcast_to(out[0], (10, 500, 4)))
    assert_array_equal(out[10:], 0.0)
    force, rest = np.split(out[0], [2], axis=1)
    assert_allclose(np.linalg.norm(force, axis=1), 1.0, rtol=1e-12)
    assert (np.abs(force.mean(axis=0)) < five_sigma(500) / np.sqrt(2.0)).all()
    assert_array_equal(rest, np.broadcast_to([20.0, 0.5], (500, 2)))


def test_where_there_is_no_hand_nothing_changes() -> None:
    """The info has the hand's force; a hand without stiffness and damping, and one that has let go, change no bit."""
    vehicle, nothing = random_vehicle(1, with_rotors=True), OrnsteinUhlenbeck(force=0.3)
    assert_array_equal(fly(vehicle, 4, [nothing, Hold(0.0, 0.0)]), fly(vehicle, 4, nothing))
    assert_array_equal(fly(vehicle, 4, [nothing, Hold(until=0.0)]), fly(vehicle, 4, nothing))


def test_distance_and_release_of_a_hand_are_drawn_for_each_episode() -> None:
    wind = Hold(10.0, 0.0, distance=(0.02, 0.06), until=(0.1, 0.2))
    hands = sample_wind(wind, 25, 500, columns=HAND)
    held = hands[:, :, 2] == 10.0
    assert_array_equal(hands[held][:, 2:], np.tile([10.0, 0.0], (held.sum(), 1)))
    assert not hands[~held].any()
    for drawn, low, high in (
        (np.linalg.norm(hands[0, :, :2], axis=1) / 10.0, 0.02, 0.06),
        (WIND_PERIOD * held.sum(axis=0), 0.1, 0.2),
    ):
        assert low - 0.006 <= drawn.min() < low + 0.01
        assert high - 0.01 < drawn.max() <= high + 0.006
        assert np.mean(drawn) == pytest.approx(0.5 * (low + high), abs=five_sigma(500) * 0.3 * (high - low) + 0.001)


def test_the_disturbance_has_the_force_of_the_hand() -> None:
    vehicle = random_vehicle(1)
    env, actions = held(vehicle, 4)
    disturbance = env.step(actions[:1])[4]["disturbance"][0]
    force = disturbance[:3] + disturbance[3:6]
    assert_allclose(disturbance[3:6], vehicle.pole.full_length / vehicle.pole.length * force, atol=1e-12)
    assert np.linalg.norm(force[:2]) > 1.0
    assert force[2] == 0.0


def test_the_papers_vehicle_refuses_a_hand() -> None:
    with pytest.raises(ValueError, match="needs a rigid vehicle"):
        Scenario(wind="hold").make()
