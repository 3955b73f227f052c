"""Controllers of a hanging load: the mirrored design, the poles of the swing, and tracking."""

import gymnasium as gym
import numpy as np
from numpy.testing import assert_allclose

from quadpend_baselines import controller
from quadpend_baselines.controllers.controller import mirror_simulation
from quadpend_baselines.controllers.lqr import riccati
from quadpend_baselines.gains import tuning
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, linearise
from quadpend_gym import Reference, Simulation, State
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.scenarios import Scenario
from tests.helpers.envs import AT_REST

LOAD = "QuadPendulumLoad-v0"


def test_a_pendulum_moves_like_one_with_opposite_direction_and_length() -> None:
    rng, rows = np.random.default_rng(0), 200
    state = rng.normal(size=(rows, STATE_SIZE))
    s = State(state)
    s.direction[:] /= np.linalg.norm(s.direction, axis=1, keepdims=True)
    s.direction_rate[:] -= np.sum(s.direction * s.direction_rate, axis=1, keepdims=True) * s.direction
    command, disturbance = rng.normal(size=(rows, 4)) + 5.0, rng.normal(size=(rows, DISTURBANCE_SIZE))
    simulation, mirrored = Simulation(), state.copy()
    mirrored[:, 12:] *= -1.0
    for array, made in ((state, simulation), (mirrored, mirror_simulation(simulation))):
        parameters = np.tile(made.parameters.as_array(), (rows, 1))
        for _ in range(20):
            advance(array, command, disturbance, parameters, 0.01, 2)
    mirrored[:, 12:] *= -1.0
    assert_allclose(mirrored, state, rtol=1e-12, atol=1e-12)


def test_the_swing_of_the_load_decays_as_the_linear_theory_says() -> None:
    """x_{k+1} = (A − B K) x_k, with the matrices of the mirrored model."""
    env, swing = gym.make(LOAD), {**AT_REST, "direction": (0.01, 0.0, -1.0)}
    observation, _ = env.reset(seed=0, options={"state": swing, "reference": Reference.hover()})
    policy, memory = controller("lqr").adapt(Scenario(task="load")), None
    states = [env.unwrapped.state.array.copy()]  # type: ignore[attr-defined]
    for _ in range(200):
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(action)
        states.append(env.unwrapped.state.array.copy())  # type: ignore[attr-defined]
    mirrored = mirror_simulation(Simulation())
    A, B, _ = linearise(mirrored)
    gain, _ = riccati(tuning("lqr", "hanging").gains, mirrored)
    x = np.array(states)
    x[:, 2] -= 2.0
    x[:, 12:] *= -1.0
    expected = [x[0, STATE_COLUMNS]]
    for _ in range(200):
        expected.append((A - B @ gain) @ expected[-1])
    found, linear = x[:, STATE_COLUMNS][:, 12], np.array(expected)[:, 12]
    assert np.abs(found - linear).max() < 0.02 * np.abs(linear).max()
    assert np.abs(found[150:]).max() < 0.2 * np.abs(found).max()  # it is damped
