"""Moving air pushes both bodies by the drag on their motion relative to it, and nothing pushes where there is none."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import energy
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec
from tests.helpers.wind import EXAMPLES, every_kind

# Half the density of air times the drag area, kg/m: what a force is made of with the square of a speed.
ON_QUADROTOR, ON_BOB = 0.5 * 1.225 * 0.01, 0.5 * 1.225 * 0.0005
STILL_AIR = Constant(velocity=(2.0, -1.0, 3.0)) + Constant(velocity=(-2.0, 1.0, -3.0))
NO_THRUST = (-1.0, 0.0, 0.0, 0.0)


def pushed(wind: Any, simulation: Any = None, **state: tuple[float, float, float]) -> dict[str, Floats]:
    """What acts in the first step from rest, but for the given parts of the state."""
    env = make_unwrapped(wind=wind, task=ENDLESS, simulation=simulation)
    env.reset(seed=0, options={"state": {**AT_REST, **state}})
    info = env.step(np.zeros(4))[4]
    names = ("force", "bob_force", "torque")
    acted = dict(zip(names, np.split(info["disturbance"], 3), strict=True))
    return {**acted, "air": info["air_velocity"]} if "air_velocity" in info else acted


def test_a_wind_pushes_bodies_at_rest_with_the_square_of_its_speed_along_itself() -> None:
    """A wind of (2, −3, 6) m/s has 7 m/s."""
    acted = pushed(Constant(velocity=(2.0, -3.0, 6.0)))
    assert_allclose(acted["force"], [ON_QUADROTOR * 7.0 * v for v in (2.0, -3.0, 6.0)], rtol=1e-12)
    assert_allclose(acted["bob_force"], [ON_BOB * 7.0 * v for v in (2.0, -3.0, 6.0)], rtol=1e-12)
    assert_array_equal(acted["torque"], 0.0)
    assert_array_equal(acted["air"], (2.0, -3.0, 6.0))


def test_ten_metres_a_second_push_the_quadrotor_with_0_6_newton() -> None:
    """The size of it: 1.225/2 · 0.01 m² · 100 m²/s²."""
    assert_allclose(pushed(Constant(velocity=(10.0, 0.0, 0.0)))["force"], (0.6125, 0.0, 0.0), rtol=1e-12)


def test_who_moves_with_the_wind_feels_nothing() -> None:
    acted = pushed(Constant(velocity=(4.0, -1.0, 2.0)), velocity=(4.0, -1.0, 2.0))
    assert_array_equal(acted["force"], 0.0)
    assert_array_equal(acted["bob_force"], 0.0)
    assert_array_equal(acted["air"], (4.0, -1.0, 2.0))


def test_the_bob_moves_with_the_rod_too() -> None:
    """At 2 rad/s the bob, 0.3 m above, is 0.6 m/s faster than the quadrotor: as fast as this wind."""
    acted = pushed(Constant(velocity=(0.6, 0.0, 0.0)), direction_rate=(2.0, 0.0, 0.0))
    assert_allclose(acted["bob_force"], 0.0, atol=1e-17)
    assert_allclose(acted["force"], (ON_QUADROTOR * 0.36, 0.0, 0.0), rtol=1e-12)
    # On a rod that points along x, half as long again, and turns about z, it moves along y.
    acted = pushed(
        STILL_AIR,
        Simulation(Parameters(rod_length=0.45)),
        direction=(1.0, 0.0, 0.0),
        direction_rate=(0.0, 2.0, 0.0),
        velocity=(0.0, 0.1, 0.0),
    )
    assert_allclose(acted["bob_force"], (0.0, -ON_BOB * 1.0**2, 0.0), rtol=1e-12)
    assert_allclose(acted["force"], (0.0, -ON_QUADROTOR * 0.1**2, 0.0), rtol=1e-12)


def test_velocities_add_up_before_the_drag_is_taken() -> None:
    acted = pushed(Constant(velocity=(3.0, 0.0, 0.0), force=1.0) + Constant(velocity=(0.0, 4.0, 0.0)))
    assert_allclose(acted["air"], (3.0, 4.0, 0.0))
    assert_allclose(acted["force"], 1.0 + ON_QUADROTOR * 5.0 * np.array([3.0, 4.0, 0.0]), rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "body", "factor"), [("quadrotor_drag_area", "force", 0.01), ("bob_drag_area", "bob_force", 0.0005)]
)
def test_forces_are_proportional_to_the_drag_area_of_their_body_alone(name: str, body: str, factor: float) -> None:
    wind = Constant(velocity=(5.0, 2.0, 0.0))
    usual = pushed(wind)
    for area in (0.0, 0.004):
        changed = pushed(wind, Simulation(Parameters(**{name: area})))
        assert_allclose(changed.pop(body), area / factor * usual[body], rtol=1e-12)
        for other, value in changed.items():
            assert_array_equal(value, usual[other])


@pytest.mark.parametrize("wind", [None, Constant(force=0.2), WINDY], ids=["calm", "force", "forces"])
def test_without_moving_air_there_is_no_drag_however_fast_one_flies(wind: Any) -> None:
    at_rest, flying = pushed(wind), pushed(wind, velocity=(30.0, 0.0, 0.0), direction_rate=(9.0, 0.0, 0.0))
    assert at_rest.keys() == {"force", "bob_force", "torque"}
    for name, value in at_rest.items():
        assert_array_equal(flying[name], value)


@every_kind
def test_every_wind_that_moves_the_air_pushes_so_besides_its_own_forces(wind: Any) -> None:
    env = make_unwrapped(wind=wind, task=ENDLESS)
    env.reset(seed=0)
    moves_air = wind is not EXAMPLES["paper_gusts"]
    velocities = []
    for action in 0.1 * draw_actions(0, 20):
        blew, velocity = env.world.wind[0].copy(), env.state.velocity.copy()
        disturbance = env.step(action)[4]["disturbance"]
        velocities.append(blew[9:])
        relative = (blew[9:] - velocity) * moves_air  # in pauses between gusts the air is still, but there
        drag = ON_QUADROTOR * np.linalg.norm(relative) * relative
        assert_allclose(disturbance[0:3] - blew[0:3], drag, rtol=1e-9, atol=1e-12)
        assert_array_equal(disturbance[6:9], blew[6:9])
    assert np.any(velocities) == moves_air


def test_winds_that_cancel_leave_still_air_in_which_one_is_slowed() -> None:
    acted = pushed(STILL_AIR, velocity=(8.0, 0.0, -6.0))
    assert_array_equal(acted["air"], 0.0)
    assert_allclose(acted["force"], (-ON_QUADROTOR * 80.0, 0.0, ON_QUADROTOR * 60.0), rtol=1e-12)
    assert_allclose(acted["bob_force"], (-ON_BOB * 80.0, 0.0, ON_BOB * 60.0), rtol=1e-12)


def test_drag_takes_energy_from_the_motion_relative_to_the_wind() -> None:
    """Its power there is −½ρA |relative velocity|³, from every direction."""
    rows, wind = 200, np.array([3.0, -2.0, 1.0])
    rng = np.random.default_rng(0)
    velocity, direction, rate = rng.normal(size=(3, rows, 3)) * [[[5.0]], [[1.0]], [[8.0]]]
    env = make_vec(rows, wind=Constant(velocity=tuple(wind.tolist())), task=ENDLESS)
    env.reset(seed=0, options={"state": {"velocity": velocity, "direction": direction, "direction_rate": rate}})
    bob_velocity = env.state.velocity + PAPER.rod_length * env.state.direction_rate
    disturbance = env.step(draw_actions(0, rows))[4]["disturbance"]
    for force, moving, factor in (
        (disturbance[:, 0:3], velocity, ON_QUADROTOR),
        (disturbance[:, 3:6], bob_velocity, ON_BOB),
    ):
        power = np.sum(force * (moving - wind), axis=-1)
        assert_allclose(power, -factor * np.linalg.norm(moving - wind, axis=-1) ** 3, rtol=1e-10)


def test_a_tumbling_flight_through_still_air_loses_the_energy_that_the_drag_takes() -> None:
    """Without thrust, energy is lost to the drag alone: by its power to first order in the period, and always lost."""
    env, vacuum = (make_unwrapped(wind=wind, task=ENDLESS) for wind in (STILL_AIR, None))
    state = {"velocity": (6.0, -3.0, 9.0), "direction": (0.6, 0.0, 0.8), "direction_rate": (0.0, 20.0, 0.0)}
    env.reset(seed=0, options={"state": state}), vacuum.reset(seed=0, options={"state": state})
    first = energy(vacuum.state.array, PAPER)
    work = 0.0
    energies = [energy(env.state.array, PAPER)]
    for _ in range(100):
        velocity = env.state.velocity.copy()
        bob_velocity = velocity + PAPER.rod_length * env.state.direction_rate
        disturbance = env.step(NO_THRUST)[4]["disturbance"]
        vacuum.step(NO_THRUST)
        work += 0.01 * (disturbance[0:3] @ velocity + disturbance[3:6] @ bob_velocity)
        energies.append(energy(env.state.array, PAPER))
    assert (np.diff(energies) < 0.0).all()
    assert_allclose(energies[-1] - energies[0], work, rtol=0.02)
    assert_allclose(energy(vacuum.state.array, PAPER), first, rtol=1e-6)


def test_a_fall_ends_at_the_speed_at_which_drag_balances_weight() -> None:
    """½ρ (A_Q + A_B) v² = (M + m_c) g: 32.7 m/s, seen from the air, which rises at 5 m/s here."""
    env = make_unwrapped(wind=Constant(velocity=(0.0, 0.0, 5.0)), task=ENDLESS)
    env.reset(seed=0, options={"state": AT_REST})
    for _ in range(2500):
        env.step(NO_THRUST)
    speed = np.sqrt(0.7 * 9.8 / (ON_QUADROTOR + ON_BOB))
    assert_allclose(env.state.velocity, (0.0, 0.0, 5.0 - speed), rtol=1e-4)
    assert_allclose(speed, 32.66, rtol=1e-3)


def test_who_drifts_is_carried_to_the_speed_of_the_wind() -> None:
    """Hanging, not standing, so that nothing falls over: behind a wind v the lag u falls as 1/u = 1/v + kt."""
    wind, area = 4.0, 0.5
    simulation = Simulation(Parameters(quadrotor_drag_area=area, bob_drag_area=area * 0.2 / 0.5))
    env = make_unwrapped(wind=Constant(velocity=(wind, 0.0, 0.0)), task=ENDLESS, simulation=simulation)
    env.reset(seed=0, options={"state": {**AT_REST, "direction": (0.0, 0.0, -1.0)}})
    for _ in range(300):
        env.step(np.zeros(4))
    # Both bodies have the same ratio of area and mass, so that the rod stays vertical.
    lag = 1.0 / (1.0 / wind + 0.5 * 1.225 * area / 0.5 * 3.0)
    assert_allclose(env.state.velocity, (wind - lag, 0.0, 0.0), rtol=2e-3, atol=1e-9)
    assert_allclose(env.state.direction, (0.0, 0.0, -1.0), atol=1e-9)


def test_still_air_brakes_what_moves_and_blows_nothing() -> None:
    env = make_unwrapped(wind="still_air")
    for velocity in (0.0, 2.0):
        env.reset(seed=0, options={"state": {**AT_REST, "velocity": (velocity, 0.0, 0.0)}})
        info = env.step(np.zeros(4))[4]
        assert_array_equal(info["air_velocity"], 0.0)
        assert_allclose(info["disturbance"][0], -0.5 * 1.225 * 0.01 * velocity**2, rtol=1e-12)
        assert_allclose(info["disturbance"][3], -0.5 * 1.225 * 0.0005 * velocity**2, rtol=1e-12)
