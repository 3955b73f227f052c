"""Classical controllers on rigid vehicles: flights through every interface, scaled gains, and actions."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines import controller
from quadpend_baselines.controllers.vehicle_gains import gains_for, scale_gains
from quadpend_baselines.gains import GAINS
from quadpend_baselines.policy.protocol import to_action, to_command
from quadpend_gym import PAPER, Simulation
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.vehicles import hover_wrench

INTERFACES = ("wrench", "rotors", "body_rates")
every_interface = pytest.mark.parametrize("interface", INTERFACES)


@every_interface
def test_actions_make_the_demanded_mean_thrust_and_torques(interface: str) -> None:
    simulation = Simulation(vehicle="hummingbird", interface=interface, period=0.02, substeps=8)
    torque = np.array([0.004, -0.003, 0.001])
    command = np.tile(hover_wrench(simulation.parameters, simulation.vehicle.pivot) + np.array([0.3, *torque]), (3, 1))
    rigid = plant_of(simulation).initial_memory(np.zeros((3, 18)))
    rigid[1, 4:7] = [0.5, -0.4, 0.2]
    rigid[2, 7:] *= [1.01, 1.02, 0.99, 1.0]
    action, reached = to_action(command, simulation, rigid)
    assert_allclose(reached, command)
    assert_allclose(to_command(action, simulation, rigid), command, rtol=0.02, atol=2e-4)


def test_gains_scale_with_the_time_constant_of_the_pendulum() -> None:
    p = PAPER
    slow = p._replace(rod_length=4.0 * p.rod_length)
    assert slow.chain_stiffness == pytest.approx(p.chain_stiffness / 4.0)
    flatness, lqr = (scale_gains(GAINS[name], p, slow) for name in ("flatness", "lqr"))
    assert flatness.attitude_bandwidth == pytest.approx(0.5 * GAINS["flatness"].attitude_bandwidth)
    assert flatness.damping == GAINS["flatness"].damping
    assert lqr.position == pytest.approx(4.0 * GAINS["lqr"].position)
    assert scale_gains(GAINS["mppi"], p, slow).steps_per_period == 2 * GAINS["mppi"].steps_per_period


def test_named_controllers_take_the_gains_of_the_vehicle() -> None:
    simulation = Simulation(vehicle="x500")
    changed: Any = controller("lqi")
    changed = changed.designed_for(simulation)
    assert changed.gains == gains_for("lqi", simulation) != GAINS["lqi"]
    assert gains_for("lqi") is gains_for("lqi", Simulation()) is GAINS["lqi"]
