"""Latency of all vehicles, and reset options and divergence of rigid ones."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym.vehicles import Simulation
from tests.helpers.envs import ENDLESS, draw_actions, make_unwrapped, make_vec, run_actions
from tests.helpers.random_settings import INTERFACES
from tests.helpers.rigid import random_vehicle, start

STEPS, SEED = 30, 50
# Whole and broken numbers of control periods of 10 ms.
LATENCIES = (0.0, 0.005, 0.02, 0.035)


def simulations(vehicle: Any, interface: str) -> Iterator[Simulation]:
    """Yield the simulations of a vehicle with every latency."""
    for latency in LATENCIES:
        yield Simulation(vehicle=vehicle, interface=interface, latency=latency)


def states(simulation: Simulation, actions: Any) -> Any:
    """Return the states after each action, shape (steps, 18)."""
    env = make_unwrapped(task=ENDLESS, simulation=simulation)
    env.reset(seed=SEED)
    return np.array([env.world.state[0].copy() for _ in map(env.step, actions)])


@pytest.mark.parametrize("interface", [*INTERFACES, None])
def test_an_action_acts_exactly_the_latency_later(interface: str | None) -> None:
    """A period of one substep resolves latencies that are no whole number of the periods of two substeps."""
    vehicle = random_vehicle(0, with_rotors=True, drag={"rotor": (0.2, 0.2, 0.4)}) if interface else "paper"
    interface = interface or "wrench"
    fine = Simulation(vehicle=vehicle, interface=interface, period=0.005, substeps=1)
    actions = 0.3 * draw_actions(2, STEPS)
    for simulation in simulations(vehicle, interface):
        late = np.concatenate([np.zeros((simulation.delayed_substeps, 4)), np.repeat(actions, 2, axis=0)])
        expected = states(fine, late[: 2 * STEPS].astype(np.float32))[1::2]
        assert_array_equal(states(simulation, actions), expected)


def test_reset_options_set_attitude_and_body_rate_of_a_rigid_vehicle() -> None:
    simulation = Simulation(vehicle="racer", interface="rotors")
    env = make_unwrapped(task=ENDLESS, simulation=simulation)
    state = {"euler": (0.5, -0.4, 2.0), "euler_rate": (1.0, -2.0, 0.5), "direction": (0.3, 0.1, 0.9)}
    env.reset(seed=0, options={"state": state})
    flight, action = start(simulation, env.world.state), draw_actions(3)
    env.step(action)
    assert_array_equal(env.world.state, flight.after(action.astype(np.float64)).state)
    assert_allclose(flight.named.euler[0], state["euler"])


def test_a_diverged_rigid_vehicle_returns_to_its_last_state_and_terminates() -> None:
    vec = make_vec(2, task=ENDLESS, vehicle="hummingbird", interface="body_rates", autoreset_mode="Disabled")
    vec.reset(seed=0)
    run_actions(vec, draw_actions(4, 3, 2))
    before = vec.world._memory.copy()
    vec.world.wind[0, :3] = 1e12
    observation, _, terminated, _, _ = vec.step(np.zeros((2, 4), np.float32))
    assert terminated.tolist() == [True, False]
    assert np.isfinite(observation).all()
    changed = (vec.world._memory != before).any(axis=1)
    assert changed.tolist() == [False, True]
