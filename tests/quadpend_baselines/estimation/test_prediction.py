"""Prediction through delays, lags and latency, and the estimate of the mass."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines import controller
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.prediction import Prediction
from quadpend_baselines.gains import tuning
from quadpend_gym import PAPER, Reference, Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Booleans, Floats
from tests.helpers.controllers import HOVER, measurement_of
from tests.helpers.envs import make_vec

DELAYED = (ActionDelay(3), MotorLag(0.02))
CIRCLE = Reference(
    offset=(0.5, 0.0, 2.0, 0.0),
    amplitude=(0.3, 0.3, 0.0, 0.2),
    frequency=(1.5, 1.5, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.0),
)


class Flight(NamedTuple):
    """The memories of a controller, the true states relative to the reference, (steps, 4, 18), and who did not fall."""

    memories: list[Any]
    states: Floats
    standing: Booleans


def fly(
    policy: Any,
    simulation: Simulation,
    steps: int,
    loop: Any = ((), ()),
    parameters: Any = None,
    reference: Reference = CIRCLE,
) -> Flight:
    """Fly a controller that knows a simulation and a loop of sensors and actuators, in calm air."""
    sensors, actuators = loop
    known = {"sensors": sensors, "actuators": actuators, "parameters": parameters}
    env = make_vec(4, simulation, autoreset_mode="Disabled", **known)
    world = env.world
    policy = policy.designed_for(simulation, Loop.of(sensors, actuators))
    observation, _ = env.reset(seed=3, options={"reference": reference})
    memory, memories, states, standing = None, [], [], np.ones(4, np.bool_)
    for step in range(steps):
        states.append(measurement_of(world.state, reference, step * simulation.period).state)
        action, memory = policy.predict(observation, memory)
        memories.append(memory)
        observation, _, terminated, _, _ = env.step(action)
        standing &= ~terminated
        if not standing.all():  # an episode without autoreset ends here
            break
    return Flight(memories, np.array(states), standing)


def test_estimate_is_carried_forward_to_the_time_when_the_action_acts() -> None:
    """The prediction over a delay of three steps is exact in calm air, to single precision of the observation."""
    simulation, loop = Simulation(), ((), (ActionDelay(3),))
    flight = fly(controller("flatness"), simulation, 40, loop=loop)
    prediction = Prediction(simulation, Loop.of(*loop))
    for step in (0, 36):
        memory = flight.memories[step]
        ahead = prediction.carry_forward(memory.estimate, memory.action)
        assert_allclose(ahead.relative, flight.states[step + 3], atol=3e-6)
        later = measurement_of(flight.states[step], CIRCLE, (step + 3) * simulation.period)
        # The derivatives of the highest order in the observation are taken as constant.
        assert_allclose(ahead.reference[:, :3], later.reference[:, :3], atol=1e-3)
        assert_allclose(ahead.yaw[:, :2], later.yaw[:, :2], atol=1e-3)


@pytest.mark.parametrize("interface", ["rotors", "body_rates"])
def test_state_of_a_rigid_vehicle_is_predicted_through_latency_and_rotor_lag(interface: str) -> None:
    """At hover in calm air the estimates of all interfaces are exact, to single precision of the observation.

    On a moving reference, the unknown absolute velocity causes a drag that is estimated as a force.
    """
    simulation = Simulation(vehicle="hummingbird", interface=interface, period=0.02, substeps=8, latency=0.03)
    flight = fly(controller("lqr"), simulation, 60, reference=HOVER)
    assert flight.standing.all()
    for memory, state in zip(flight.memories, flight.states, strict=True):
        assert_allclose(memory.estimate.state, state, atol=2e-5)
        assert_allclose(memory.estimate.disturbance, 0.0, atol=3e-4)


def test_prediction_keeps_a_delayed_loop_stable() -> None:
    assert fly(controller("flatness"), Simulation(), 100, loop=((), DELAYED)).standing.all()


@pytest.mark.parametrize("mass_time", [0.3, 0.0])
def test_lasting_vertical_force_is_attributed_to_the_mass(mass_time: float) -> None:
    """The quadrotor and the bob have 1.3 times their nominal masses."""
    masses = {name: (1.3 * getattr(PAPER, name),) * 2 for name in ("quadrotor_mass", "bob_mass")}
    gains = tuning("flatness").gains
    policy = OutputFeedback(Flatness, replace(gains, estimator=replace(gains.estimator, mass_time=mass_time)))
    last = fly(policy, Simulation(), 200, parameters=masses).memories[-1]
    assert_allclose(last.estimate.mass_ratio, 1.3 if mass_time else 1.0, rtol=5e-3)
    weight = 0.3 * PAPER.hover_thrust
    assert_allclose(policy.estimated_disturbance(last)[:, 2], -weight, rtol=0.02)
    assert_allclose(last.estimate.disturbance[:, 2], 0.0 if mass_time else -weight, atol=0.02 * weight)
