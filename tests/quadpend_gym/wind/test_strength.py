"""An environment warns about a wind that pushes a light vehicle with more than its weight."""

import gymnasium as gym
import pytest

from quadpend_gym import PAPER, Constant, Drawn, Parameters, Simulation
from quadpend_gym.scenarios import SCENARIOS
from quadpend_gym.wind import as_wind
from quadpend_gym.wind.strength import largest_force
from quadpend_gym.wrappers import WindWrapper

LIGHT = {"parameters": {"quadrotor_mass": 0.025, "bob_mass": 0.005}}


@pytest.mark.parametrize("wind", ["windy", "paper", Drawn("storm"), Constant(velocity=(9.0, 0.0, 0.0))])
def test_a_vehicle_of_30_g_in_strong_wind_gives_a_warning(wind: object) -> None:
    with pytest.warns(UserWarning, match=r"the wind pushes with up to .* N and the vehicle weighs 0\.29 N"):
        gym.make("quadpend_gym:QuadPendulum-v0", simulation=LIGHT, wind=wind)
    env = gym.make("quadpend_gym:QuadPendulum-v0", simulation=LIGHT)
    with pytest.warns(UserWarning, match="the wind pushes"):
        WindWrapper(env, wind)


def test_a_vehicle_of_30_g_in_weak_wind_gives_no_warning() -> None:
    gym.make("quadpend_gym:QuadPendulum-v0", simulation=LIGHT, wind=Constant(force=0.05) + Constant(torque=0.1))


def test_the_largest_force_contains_drag_and_the_force_on_the_bob() -> None:
    drag = 0.5 * 1.225 * (PAPER.quadrotor_drag_area + PAPER.bob_drag_area) * 10.0**2
    wind = Constant(force=(1.0, 0.0, 0.0), bob_force=(0.5, 0.0, 0.0), velocity=(10.0, 0.0, 0.0))
    assert largest_force(as_wind(wind), Simulation()) == pytest.approx(1.5 + drag)


def test_no_scenario_of_the_package_pushes_the_paper_s_vehicle_with_more_than_its_weight() -> None:
    forces = [largest_force(scenario.wind.models, Simulation()) for scenario in SCENARIOS.values()]
    assert 0.5 < max(forces) / Parameters().hover_thrust < 1.0
