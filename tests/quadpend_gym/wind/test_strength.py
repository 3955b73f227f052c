"""An environment warns about a wind that pushes a light vehicle with more than its weight."""

import gymnasium as gym
import pytest

from quadpend_gym import PAPER, Constant, Drawn, Simulation
from quadpend_gym.wind import as_wind
from quadpend_gym.wind.strength import largest_force


@pytest.mark.parametrize("wind", [Drawn("storm"), Constant(force=0.5), Constant(velocity=(30.0, 0.0, 0.0))])
def test_a_light_vehicle_in_strong_wind_gives_a_warning(wind: object) -> None:
    with pytest.warns(UserWarning, match=r"the wind pushes with up to .* N and the vehicle weighs 0\.\d+ N"):
        gym.make("quadpend_gym:QuadPendulum-v0", vehicle="crazyflie", wind=wind)


def test_a_light_vehicle_in_weak_wind_gives_no_warning() -> None:
    gym.make("quadpend_gym:QuadPendulum-v0", vehicle="crazyflie", wind=Constant(force=0.05) + Constant(torque=0.1))


def test_the_largest_force_contains_drag_and_the_force_on_the_bob() -> None:
    drag = 0.5 * 1.225 * (PAPER.quadrotor_drag_area + PAPER.bob_drag_area) * 10.0**2
    wind = Constant(force=(1.0, 0.0, 0.0), bob_force=(0.5, 0.0, 0.0), velocity=(10.0, 0.0, 0.0))
    assert largest_force(as_wind(wind), Simulation()) == pytest.approx(1.5 + drag)
