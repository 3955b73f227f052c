"""NMPC: its linear limit, optimal plans within the limits, failures, and every interface of a rigid vehicle."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.controllers.lqr import LqrGains
from quadpend_baselines.controllers.nmpc import Nmpc, NmpcGains
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import PAPER, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import Scenario
from tests.helpers.controllers import (
    CALM,
    HOVER,
    flat_state_and_command,
    measurement_of,
    run_law,
    run_policy,
    tilted_pendulum,
    true_estimate,
)
from tests.helpers.physics import simulate_period

FEEDBACK = LqrGains(0.4, 1.3, 1.6, 3.5)
SMALL = NmpcGains(FEEDBACK, periods=8, period=0.04)


def gain(law: Nmpc) -> Floats:
    """Return the gain of the LQR of actions with the law's weights, shape (4, 16)."""
    _, R, P = law.weights
    hover = flat_state_and_command(HOVER, 0.0, CALM, PAPER)[0][:, STATE_COLUMNS]
    _, (A,), (B,) = law.linearise(hover, np.zeros((1, 4)), CALM[np.newaxis])
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


def test_near_the_reference_the_action_is_that_of_the_lqr() -> None:
    """The deviations are so small that their squares do not matter; the gain is that for the period of the horizon."""
    law = Nmpc(SMALL, Simulation())
    x_d, _ = flat_state_and_command(HOVER, 0.0, CALM, PAPER)
    state = x_d + 1e-5 * np.random.default_rng(4).normal(size=(3, 18))
    State(state).direction[:, 2], State(state).direction_rate[:, 2] = 1.0, 0.0
    action, _ = run_law(law, state)
    x = rotate_state((state - x_d)[:, STATE_COLUMNS], -State(state).euler[:, 2])
    assert np.abs(action).max() > 1e-5
    assert_allclose(action, -x @ gain(law).T, atol=1e-8)


def cost(law: Nmpc, state: Floats, actions: Floats) -> float:
    """Return the cost (1) at hover of actions, shape (H, 4), by the simulation of the environment."""
    simulation = law.simulation
    Q, R, P = law.weights
    x_d, _ = flat_state_and_command(HOVER, 0.0, CALM, PAPER)
    total = 0.0
    for k, action in enumerate(actions):
        command = plant_of(simulation).command(action[np.newaxis])
        state = simulate_period(state, command, CALM, PAPER, law.steps * simulation.period, 2 * law.steps)
        x = (state - x_d)[0, STATE_COLUMNS]
        total += float(x @ (Q if k + 1 < len(actions) else P) @ x + action @ R @ action) / 2.0
    return total


def test_no_similar_plan_within_the_limits_costs_less() -> None:
    """At a tilt of 20°, where the plan reaches the limits; a random change of the converged plan raises the cost."""
    law, rng = Nmpc(SMALL, Simulation()), np.random.default_rng(5)
    state = tilted_pendulum(0.35, 0.4)
    estimate = true_estimate(measurement_of(state))
    horizon = law._horizon(estimate)
    plan = horizon.states, horizon.actions
    for _ in range(30):
        plan = law._improved(*plan, estimate, horizon)
    actions = plan[1][0]
    assert np.isclose(np.abs(actions), 1.0).any()
    least = cost(law, state, actions)
    for size in (1e-3, 1e-2, 0.1):
        for _ in range(20):
            changed = actions + size * rng.normal(size=actions.shape)
            assert cost(law, state, np.clip(changed, -1.0, 1.0)) > least * (1.0 - 1e-9)


def test_after_a_failure_the_law_continues_its_plan_and_then_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    law, state = Nmpc(SMALL, Simulation()), tilted_pendulum(0.1, 0.5)
    _, memory = run_law(law, state)
    plan = memory.actions[0]
    monkeypatch.setattr(Nmpc, "_improved", lambda _, states, actions, *__: (np.nan * states, np.nan * actions))
    actions = []
    for _ in range(5):
        action, memory = run_law(law, state, memory)
        actions.append(action[0])
    assert_array_equal(memory.failures, 5)
    assert_allclose(actions[0], plan[0] + 0.25 * (plan[1] - plan[0]), atol=1e-12)
    assert_allclose(actions[-1], 0.0, atol=1e-6)


def test_the_plan_of_a_row_does_not_depend_on_the_other_rows() -> None:
    law, calm, tilted = Nmpc(SMALL, Simulation()), *map(tilted_pendulum, (0.0, 0.35), (0.0, 0.4))
    together, _ = run_law(law, np.vstack([calm, tilted]))
    assert_array_equal(together, np.vstack([run_law(law, state)[0] for state in (calm, tilted)]))


@pytest.mark.parametrize("interface", ["body_rates", "wrench", "rotors"])
def test_a_rigid_vehicle_hovers_in_wind_with_its_latency(interface: Any) -> None:
    wind = {"kind": "ornstein_uhlenbeck", "force": 0.12}
    scenario = Scenario(vehicle="hummingbird", interface=interface, latency=0.02, wind=wind, duration=4.0)
    env = scenario.make_vec(1, AutoresetMode.DISABLED)
    _, results = run_policy(controller("nmpc").adapt(scenario), env, scenario.steps)
    assert np.linalg.norm(results[-1][4]["tracking_error"][0]) < 0.06


def test_threads_that_share_a_controller_get_the_actions_of_separate_ones() -> None:
    policy, observations = controller("nmpc"), np.random.default_rng(0).normal(0.0, 0.02, (3, 30, 1, 36))

    def fly(row: Floats) -> list[Any]:
        actions, memory = [], None
        for observation in row:
            action, memory = policy.predict(observation, memory)
            actions.append(action)
        return actions

    expected = [fly(row) for row in observations]
    with ThreadPoolExecutor(3) as threads:
        assert_array_equal([*threads.map(fly, observations)], expected)
