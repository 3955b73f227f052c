"""Wind exerts drag on both bodies by their velocity relative to the air; without a wind velocity there is no drag."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Disturbance, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DISTURBANCE_FIELDS, DISTURBANCE_SIZE
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec
from tests.helpers.wind import EXAMPLES, every_kind

# ½ ρ A of each body, kg/m; times the square of the speed this is the drag.
ON_QUADROTOR, ON_BOB = 0.5 * 1.225 * 0.01, 0.5 * 1.225 * 0.0005
# Two winds whose velocities cancel.
STILL_AIR = Constant(velocity=(2.0, -1.0, 3.0)) + Constant(velocity=(-2.0, 1.0, -3.0))
NO_THRUST = (-1.0, 0.0, 0.0, 0.0)


def disturbance_at_rest(wind: Any, simulation: Any = None, **state: tuple[float, float, float]) -> dict[str, Floats]:
    """Return the disturbance in the first step. All fields of the state that are not given are those of `AT_REST`."""
    env = make_unwrapped(wind=wind, task=ENDLESS, simulation=simulation)
    env.reset(seed=0, options={"state": {**AT_REST, **state}})
    info = env.step(np.zeros(4))[4]
    disturbance = {name: info["disturbance"][part] for name, part in DISTURBANCE_FIELDS.items()}
    return {**disturbance, "air": info["air_velocity"]} if "air_velocity" in info else disturbance


def test_drag_on_bodies_at_rest_has_the_direction_of_the_wind_and_grows_with_its_speed_squared() -> None:
    """The speed of the wind (2, −3, 6) m/s is 7 m/s."""
    disturbance = disturbance_at_rest(Constant(velocity=(2.0, -3.0, 6.0)))
    assert_allclose(disturbance["force"], [ON_QUADROTOR * 7.0 * v for v in (2.0, -3.0, 6.0)], rtol=1e-12)
    assert_allclose(disturbance["bob_force"], [ON_BOB * 7.0 * v for v in (2.0, -3.0, 6.0)], rtol=1e-12)
    assert_array_equal(disturbance["torque"], 0.0)
    assert_array_equal(disturbance["air"], (2.0, -3.0, 6.0))


def test_bodies_that_move_with_the_wind_have_no_drag() -> None:
    disturbance = disturbance_at_rest(Constant(velocity=(4.0, -1.0, 2.0)), velocity=(4.0, -1.0, 2.0))
    assert_array_equal(disturbance["force"], 0.0)
    assert_array_equal(disturbance["bob_force"], 0.0)
    assert_array_equal(disturbance["air"], (4.0, -1.0, 2.0))


def test_the_velocity_of_the_bob_includes_the_rotation_of_the_rod() -> None:
    """At 2 rad/s the bob, 0.3 m above the quadrotor, is 0.6 m/s faster, which is the speed of this wind."""
    disturbance = disturbance_at_rest(Constant(velocity=(0.6, 0.0, 0.0)), direction_rate=(2.0, 0.0, 0.0))
    assert_allclose(disturbance["bob_force"], 0.0, atol=1e-17)
    assert_allclose(disturbance["force"], (ON_QUADROTOR * 0.36, 0.0, 0.0), rtol=1e-12)
    # With a rod of 0.45 m that points along x and rotates about z, the bob moves along y.
    disturbance = disturbance_at_rest(
        STILL_AIR,
        Simulation(replace(VEHICLES["paper"], pole=replace(VEHICLES["paper"].pole, length=0.45, extent=0.45))),
        direction=(1.0, 0.0, 0.0),
        direction_rate=(0.0, 2.0, 0.0),
        velocity=(0.0, 0.1, 0.0),
    )
    assert_allclose(disturbance["bob_force"], (0.0, -ON_BOB * 1.0**2, 0.0), rtol=1e-12)
    assert_allclose(disturbance["force"], (0.0, -ON_QUADROTOR * 0.1**2, 0.0), rtol=1e-12)


@pytest.mark.parametrize("wind", [None, Constant(force=0.2), WINDY], ids=["calm", "force", "forces"])
def test_without_a_wind_velocity_there_is_no_drag_at_any_speed(wind: Any) -> None:
    at_rest, moving = (
        disturbance_at_rest(wind),
        disturbance_at_rest(wind, velocity=(30.0, 0.0, 0.0), direction_rate=(9.0, 0.0, 0.0)),
    )
    assert at_rest.keys() == {"force", "bob_force", "torque"}
    for name, value in at_rest.items():
        assert_array_equal(moving[name], value)


@every_kind
def test_every_wind_model_with_a_velocity_adds_this_drag_to_its_own_forces(wind: Any) -> None:
    env = make_unwrapped(wind=wind, task=ENDLESS)
    env.reset(seed=0)
    moves_air = wind is not EXAMPLES["paper_gusts"]
    velocities = []
    for action in 0.1 * draw_actions(0, 20):
        sample, velocity = env.world.wind[0].copy(), env.state.velocity.copy()
        of_model, air_velocity = Disturbance(sample[:DISTURBANCE_SIZE]), sample[DISTURBANCE_SIZE:]
        disturbance = Disturbance(env.step(action)[4]["disturbance"])
        velocities.append(air_velocity)
        relative = (air_velocity - velocity) * moves_air  # between gusts the air is at rest and still exerts drag
        drag = ON_QUADROTOR * np.linalg.norm(relative) * relative
        assert_allclose(disturbance.force - of_model.force, drag, rtol=1e-9, atol=1e-12)
        assert_array_equal(disturbance.torque, of_model.torque)
    assert np.any(velocities) == moves_air


def test_winds_whose_velocities_cancel_give_air_at_rest_which_exerts_drag() -> None:
    disturbance = disturbance_at_rest(STILL_AIR, velocity=(8.0, 0.0, -6.0))
    assert_array_equal(disturbance["air"], 0.0)
    assert_allclose(disturbance["force"], (-ON_QUADROTOR * 80.0, 0.0, ON_QUADROTOR * 60.0), rtol=1e-12)
    assert_allclose(disturbance["bob_force"], (-ON_BOB * 80.0, 0.0, ON_BOB * 60.0), rtol=1e-12)


def test_drag_dissipates_the_energy_of_the_motion_relative_to_the_wind() -> None:
    """In the frame of the air its power is −½ρA |relative velocity|³ in every direction."""
    rows, wind = 200, np.array([3.0, -2.0, 1.0])
    rng = np.random.default_rng(0)
    velocity, direction, rate = rng.normal(size=(3, rows, 3)) * [[[5.0]], [[1.0]], [[8.0]]]
    env = make_vec(rows, wind=Constant(velocity=tuple(wind.tolist())), task=ENDLESS)
    env.reset(seed=0, options={"state": {"velocity": velocity, "direction": direction, "direction_rate": rate}})
    bob_velocity = env.state.velocity + PAPER.rod_length * env.state.direction_rate
    disturbance = Disturbance(env.step(draw_actions(0, rows))[4]["disturbance"])
    for force, body_velocity, factor in (
        (disturbance.force, velocity, ON_QUADROTOR),
        (disturbance.bob_force, bob_velocity, ON_BOB),
    ):
        power = np.sum(force * (body_velocity - wind), axis=-1)
        assert_allclose(power, -factor * np.linalg.norm(body_velocity - wind, axis=-1) ** 3, rtol=1e-10)


def test_a_falling_body_reaches_the_speed_at_which_drag_balances_weight() -> None:
    """½ρ (A_Q + A_B) v² = (M + m_c) g gives v = 32.7 m/s relative to the air, which rises at 5 m/s."""
    env = make_unwrapped(wind=Constant(velocity=(0.0, 0.0, 5.0)), task=ENDLESS)
    env.reset(seed=0, options={"state": AT_REST})
    for _ in range(2500):
        env.step(NO_THRUST)
    speed = np.sqrt(0.7 * 9.8 / (ON_QUADROTOR + ON_BOB))
    assert_allclose(env.state.velocity, (0.0, 0.0, 5.0 - speed), rtol=1e-4)
    assert_allclose(speed, 32.66, rtol=1e-3)
