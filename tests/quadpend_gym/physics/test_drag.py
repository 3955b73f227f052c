"""Wind exerts drag on both bodies by their velocity relative to the air; without a wind velocity there is no drag."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Disturbance
from tests.helpers.envs import AT_REST, ENDLESS, WINDY, draw_actions, make_unwrapped, make_vec

# ½ ρ A of each body, kg/m; times the square of the speed this is the drag.
ON_QUADROTOR, ON_BOB = 0.5 * 1.225 * 0.01, 0.5 * 1.225 * 0.0005
WIND = np.array([3.0, -2.0, 1.0])
# Two winds whose velocities cancel exert drag as air at rest does.
STILL_AIR = Constant(velocity=(2.0, -1.0, 3.0)) + Constant(velocity=(-2.0, 1.0, -3.0))


@pytest.mark.parametrize(("wind", "air"), [(Constant(velocity=(3.0, -2.0, 1.0)), WIND), (STILL_AIR, np.zeros(3))])
def test_drag_is_opposed_to_the_velocity_relative_to_the_air_and_grows_with_its_square(wind: Any, air: Any) -> None:
    rows, rng = 200, np.random.default_rng(0)
    velocity, direction, rate = rng.normal(size=(3, rows, 3)) * [[[5.0]], [[1.0]], [[8.0]]]
    velocity[0], rate[0] = air, 0.0  # moves with the air
    env = make_vec(rows, wind=wind, task=ENDLESS)
    env.reset(seed=0, options={"state": {"velocity": velocity, "direction": direction, "direction_rate": rate}})
    bob_velocity = env.state.velocity + PAPER.rod_length * env.state.direction_rate
    info = env.step(draw_actions(0, rows))[4]
    disturbance = Disturbance(info["disturbance"])
    for force, body, factor in (
        (disturbance.force, velocity, ON_QUADROTOR),
        (disturbance.bob_force, bob_velocity, ON_BOB),
    ):
        relative = air - body
        expected = factor * np.linalg.norm(relative, axis=-1, keepdims=True) * relative
        assert_allclose(force, expected, rtol=1e-10, atol=1e-14)
    assert_array_equal(disturbance.torque, 0.0)
    assert_allclose(info["air_velocity"], np.tile(air, (rows, 1)))


@pytest.mark.parametrize("wind", [None, Constant(force=0.2), WINDY], ids=["calm", "force", "forces"])
def test_without_a_wind_velocity_there_is_no_drag_at_any_speed(wind: Any) -> None:
    disturbances = []
    for state in (AT_REST, {**AT_REST, "velocity": (30.0, 0.0, 0.0), "direction_rate": (9.0, 0.0, 0.0)}):
        env = make_unwrapped(wind=wind, task=ENDLESS)
        env.reset(seed=0, options={"state": state})
        info = env.step(np.zeros(4))[4]
        assert "air_velocity" not in info
        disturbances.append(info["disturbance"])
    assert_array_equal(*disturbances)
