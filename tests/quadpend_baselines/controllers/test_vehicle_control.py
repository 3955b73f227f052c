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
from quadpend_gym.vehicles import VEHICLES, hover_wrench
from quadpend_gym.wrappers import VectorOutputFeedbackWrapper
from tests.helpers.controllers import make_vec_of

INTERFACES = ("wrench", "rotors", "body_rates")
every_interface = pytest.mark.parametrize("interface", INTERFACES)


def fly(name: str, simulation: Simulation, velocities: bool = True) -> None:
    """Fly two episodes of 2 s in calm air and check that none terminates."""
    env: Any = make_vec_of(simulation, 2)
    env = env if velocities else VectorOutputFeedbackWrapper(env)
    policy: Any = controller(name, simulation)
    observation, _ = env.reset(seed=3)
    memory = None
    for _ in range(round(2.0 / simulation.period)):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated.any()


@every_interface
@pytest.mark.parametrize("name", ["flatness", "dual-mode", "lqr", "lqi", "mppi", "adrc-tuned", "adrc-linear"])
def test_controllers_fly_the_hummingbird_for_2_s(name: str, interface: str) -> None:
    fly(name, Simulation(vehicle="hummingbird", interface=interface))


@pytest.mark.parametrize("vehicle", [name for name in VEHICLES if name not in ("paper", "hummingbird")])
def test_adrc_flies_every_other_vehicle_for_2_s(vehicle: str) -> None:
    fly("adrc-matched", Simulation(vehicle=vehicle, interface="rotors", period=0.02, substeps=8))


@pytest.mark.parametrize("name", ["adrc-paper", "adrc-tuned"])
def test_adrc_flies_through_the_latency_of_a_real_vehicle_without_measured_velocities(name: str) -> None:
    simulation = Simulation(vehicle="hummingbird", interface="body_rates", period=0.02, substeps=8, latency=0.03)
    fly(name, simulation, velocities=False)


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
