"""Optimal flights: their step is that of the environment, they respect all limits, and they can be flown."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines.planning.transcription import (
    Flight,
    KnownEpisode,
    Plant,
    Transcription,
    tracked_point,
)
from quadpend_gym import QuadPendulumVectorEnv, Simulation
from quadpend_gym.envs.outcome import TRACKING_ERROR
from quadpend_gym.wind import Dryden, OrnsteinUhlenbeck

STEPS = 25
PLANT = Plant(Simulation(latency=0.015), moves_air=True)
WIND = [Dryden("severe"), OrnsteinUhlenbeck(force=0.3, bob_force=0.1, torque=0.05)]


def make():  # type: ignore[no-untyped-def]
    """One sub-environment with drag, forces, a torque and its own parameters, whose episode outlasts the flight."""
    parts = {"wind": WIND, "parameters": {"share": 0.3}}
    return QuadPendulumVectorEnv(1, max_episode_steps=STEPS + 1, latency=PLANT.simulation.latency, **parts)


def known_episode(env, seed: int) -> KnownEpisode:  # type: ignore[no-untyped-def]
    """The episode that a seed draws, for N control steps; no wind model reads the state, so any flight reveals it."""
    env.reset(seed=seed)
    world = env.world
    start, parameters = world.state[0].copy(), world.parameters[0].copy()
    wind, target = [], []
    for _ in range(STEPS):
        wind.append(world.wind[0].copy())
        _, outcome = world.step(np.zeros((1, 4), np.float32))
        target.append(tracked_point(world.state[0], parameters) - outcome[TRACKING_ERROR, 0])
    return KnownEpisode(start, parameters, np.array(wind), np.array(target))


def fly(env, seed: int, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """States, shape (N + 1, 18), and tracking errors, shape (N, 3), of a flight that performs given actions."""
    env.reset(seed=seed)
    world, errors = env.world, []
    states = [world.state[0].copy()]
    for action in actions:
        *_, terminated, truncated, info = env.step(action[np.newaxis].astype(np.float32))
        assert not terminated[0]
        assert not truncated[0]
        states.append(world.state[0].copy())
        errors.append(info["tracking_error"][0])
    return np.array(states), np.array(errors)


def test_a_step_of_the_plant_is_a_step_of_the_environment() -> None:
    env, actions = make(), np.random.default_rng(1).uniform(-1.0, 1.0, (STEPS, 4)).astype(np.float32)
    episode = known_episode(env, 3)
    flown, _ = fly(env, 3, actions)
    states = np.hstack([flown, PLANT.memories(flown, actions)])
    x, a, q, y = PLANT.step()
    known = np.hstack([episode.wind, np.tile(episode.parameters, (STEPS, 1))])
    moved = np.array(ca.Function("step", [x, a, q], [y])(states[:-1].T, actions.T, known.T)).T
    assert_allclose(moved, states[1:], rtol=1e-6, atol=1e-6)


def test_an_optimal_flight_is_flown_by_the_environment_as_planned() -> None:
    env = make()
    limits = env.world.task.limits
    episode, problem = known_episode(env, 5), Transcription(PLANT, limits, STEPS)
    nothing = Flight(episode.start[np.newaxis], np.zeros((0, 4)))
    solution = problem.solve(episode, *problem.guess(nothing, episode))
    assert solution.status == "Solve_Succeeded"
    assert np.abs(solution.actions).max() <= 1.0
    assert np.all(solution.states[:, 14] >= np.cos(limits.pendulum_angle))

    _, errors = fly(env, 5, solution.actions)
    assert np.sqrt(np.mean(np.sum(errors**2, axis=1))) == pytest.approx(solution.rmse, abs=1e-6)
