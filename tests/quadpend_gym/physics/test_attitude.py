"""Conversions between Euler angles, quaternions, their rates and body rates."""

import numpy as np
from numpy.testing import assert_allclose

from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.vehicles import Pole, Simulation, Vehicle
from tests.helpers.physics import random_states
from tests.helpers.rigid import at_rest, random_vehicle, start

ROWS, SHORT = 200, 1e-9  # s


def test_the_outputs_are_the_euler_angles_and_rates_of_the_attitude() -> None:
    """A step of 1 ns changes nothing but rounds through both conversions."""
    simulation = Simulation(vehicle=random_vehicle(0), period=SHORT, substeps=1)
    states = random_states(ROWS, 1)
    states[:, 7] = np.random.default_rng(1).uniform(-1.4, 1.4, ROWS)
    before = start(simulation, states)
    after = before.after(np.zeros(4)).named
    assert_allclose(after.euler[:, 1], before.named.euler[:, 1], rtol=0.0, atol=1e-7)
    difference = after.euler - before.named.euler
    assert_allclose(difference - 2.0 * np.pi * np.round(difference / (2.0 * np.pi)), 0.0, atol=1e-7)
    assert_allclose(after.euler_rate, before.named.euler_rate, rtol=0.0, atol=1e-5)


def test_the_yaw_is_continuous_over_several_turns() -> None:
    top = Vehicle(1.0, (0.02, 0.02, 0.03), Pole(1e-5, 0.01), torque=(1.0, 1.0))
    flight = start(Simulation(vehicle=top, period=0.1, substeps=10), at_rest())
    flight.memory[:, BODY_RATE:ROTOR_THRUST] = 0.0, 0.0, -7.0
    for step in range(1, 31):
        flight = flight.after(np.zeros(4))
        assert abs(flight.named.euler[0, 2] + 0.7 * step) <= 1e-6
