"""NMPC: its model, its linear limit, optimal plans within the limits, real-time iterations, failures and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.controllers import nmpc
from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.controllers.nmpc import Nmpc
from quadpend_baselines.gains import LqrGains, NmpcGains
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import PAPER, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.state import State
from quadpend_gym.vehicles import VEHICLES, Drag, hover_wrench, mixing
from tests.helpers.controllers import (
    CALM,
    HOVER,
    disturbance_of,
    flat_state_and_command,
    run_law,
    simulation_of,
    tilted_pendulum,
)
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances, random_states, simulate_period

ca = pytest.importorskip("casadi", reason="casadi is not installed: pip install 'quadpend-gym[mpc]'")
from quadpend_baselines.controllers import nmpc_model  # noqa: E402

FEEDBACK = LqrGains(0.4, 1.3, 1.6, 3.5)
SMALL = NmpcGains(FEEDBACK, periods=8, period=0.04, iterations=1)
WIND = disturbance_of((0.3, -0.2, 0.15), (0.05, 0.03, 0.0), (0.1, -0.05, 0.03))


def test_model_moves_like_the_simulation() -> None:
    simulation = simulation_of(UNEQUAL, period=0.04, substeps=2)
    state, command, wind = random_states(20, 2), random_commands(20, 2, UNEQUAL), random_disturbances(20, 2)
    moved = np.array(nmpc_model.period_map(simulation)(state.T, command.T, wind.T)).T
    assert_allclose(moved, simulate_period(state, command, wind, UNEQUAL, 0.04, 2), rtol=1e-10, atol=1e-10)


@pytest.mark.extras
def test_rigid_model_moves_like_the_simulation() -> None:
    """The vehicle has products of inertia, an offset pivot, a pole with inertia and angular drag, but no lag."""
    vehicle = VEHICLES["hummingbird"]
    vehicle = replace(
        vehicle,
        inertia=((3.2e-3, 2e-4, -1e-4), (2e-4, 4e-3, 3e-4), (-1e-4, 3e-4, 5.5e-3)),
        pivot=(0.01, -0.02, 0.05),
        pole=replace(vehicle.pole, drag_area=0.0),
        drag=Drag(angular=(1e-3, 2e-3, 3e-3)),
        rotors=replace(vehicle.rotors, lag_up=0.0),
    )
    simulation = Simulation(vehicle=vehicle, period=5e-4, substeps=1)
    state, wind = random_states(6, 3, 0.5), 0.2 * random_disturbances(6, 3)
    action = np.random.default_rng(3).uniform(-0.3, 0.3, (6, 4))
    command = hover_wrench(simulation.parameters, vehicle.pivot) + simulation.command_scale * action
    memory = rigid_from_state(state, simulation)
    memory[:, ROTOR_THRUST:] = np.linalg.solve(mixing(vehicle), command.T).T
    moved = np.array(nmpc_model.period_map(simulation)(state.T, command.T, wind.T)).T
    parameters = np.tile(simulation.parameters.as_array(), (6, 1))
    plant_of(simulation).advance(state, memory, action, wind, parameters)
    assert_allclose(moved, state, rtol=1e-10, atol=1e-10)


def test_near_the_reference_the_command_is_that_of_the_lqr() -> None:
    """The deviations are so small that their squares do not matter; the gain is that for the period of the horizon."""
    law = Nmpc(SMALL, Simulation())
    x_d, u_d = flat_state_and_command(HOVER, 0.0, CALM, PAPER)
    state = x_d + 1e-5 * np.random.default_rng(4).normal(size=(3, 18))
    State(state).direction[:, 2], State(state).direction_rate[:, 2] = 1.0, 0.0
    command, _ = run_law(law, state)
    gain, _ = riccati(FEEDBACK, law.horizon_simulation)
    x = rotate_state((state - x_d)[:, STATE_COLUMNS], -State(state).euler[:, 2])
    assert np.abs(command - u_d).max() > 1e-4
    assert_allclose(command, u_d - x @ gain.T, atol=1e-6)


def cost(law: Nmpc, state: Floats, commands: Floats) -> float:
    """Return the cost (1) at hover of commands, shape (H, 4), by the simulation of the environment."""
    simulation = law.horizon_simulation
    (Q, R), (_, P) = weights(FEEDBACK, simulation), riccati(FEEDBACK, simulation)
    x_d, u_d = flat_state_and_command(HOVER, 0.0, CALM, PAPER)
    total = 0.0
    for step, command in enumerate([*commands, u_d]):
        x = rotate_state((state - x_d)[:, STATE_COLUMNS], -State(state).euler[:, 2])[0]
        if step == len(commands):
            return total + float(x @ P @ x) / 2.0
        u = (command - u_d)[0]
        total += float(x @ Q @ x + u @ R @ u) / 2.0
        state = simulate_period(state, command, CALM, PAPER, simulation.period, simulation.substeps)
        pendulum = State(state[0]).direction[2]
        total += 1e4 * max(0.6 - pendulum, 0.0) ** 2
    raise AssertionError


def test_no_similar_plan_within_the_limits_costs_less() -> None:
    """At a tilt of 20°, where the plan reaches the limits; a random change of the converged plan raises the cost."""
    law, rng = Nmpc(replace(SMALL, iterations=30), Simulation()), np.random.default_rng(5)
    state = tilted_pendulum(0.35, 0.4)
    _, memory = run_law(law, state)
    lowest, highest = law.limits.T
    commands = memory.commands[0]
    assert (np.isclose(commands, lowest) | np.isclose(commands, highest)).any()
    least = cost(law, state, commands)
    for size in (1e-3, 1e-2, 0.1):
        for _ in range(20):
            changed = commands + size * law.simulation.command_scale * rng.normal(size=commands.shape)
            assert cost(law, state, np.clip(changed, lowest, highest)) > least * (1.0 - 1e-9)


def test_after_a_failure_the_law_continues_its_plan_and_then_the_feedback_of_the_lqr(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    law, state = Nmpc(SMALL, Simulation()), tilted_pendulum(0.1, 0.5)
    _, memory = run_law(law, state)
    plan = memory.commands[0]
    monkeypatch.setattr(nmpc, "sqp_step", lambda *_: lambda X, U, *_: (np.nan * X, np.nan * U))
    commands = []
    for _ in range(5):
        command, memory = run_law(law, state, memory)
        commands.append(command)
    assert_array_equal(memory.failures, 5)
    assert_allclose(commands[0][0], plan[0] + 0.25 * (plan[1] - plan[0]), atol=1e-12)
    x_d, u_d = flat_state_and_command(HOVER, 0.0, CALM, PAPER)
    gain, _ = riccati(FEEDBACK, law.horizon_simulation)
    feedback = u_d - (state - x_d)[:, STATE_COLUMNS] @ gain.T
    assert_allclose(commands[-1], np.clip(feedback, *law.limits.T), atol=1e-9)
