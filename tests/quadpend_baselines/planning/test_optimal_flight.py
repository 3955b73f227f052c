"""Optimal flights: their step is that of the environment, they respect all limits, and they can be flown."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose

from quadpend_gym import QuadPendulumVectorEnv, Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.wind import Dryden, OrnsteinUhlenbeck
from quadpend_gym.wrappers import VectorActuatorWrapper, VectorParameterWrapper

ca = pytest.importorskip("casadi", reason="casadi is not installed: pip install 'quadpend-gym[mpc]'")
from quadpend_baselines.planning.episode import Flight, known_episode, record_flight  # noqa: E402
from quadpend_baselines.planning.replay import track  # noqa: E402
from quadpend_baselines.planning.transcription import Plant, Transcription  # noqa: E402

STEPS = 25
WIND = [Dryden("severe"), OrnsteinUhlenbeck(force=0.3, bob_force=0.1, torque=0.05)]


class RandomActions:
    """A policy whose actions are random but the same in every flight."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):  # type: ignore[no-untyped-def]
        generator = np.random.default_rng(1) if state is None else state
        return generator.uniform(-1.0, 1.0, (1, 4)).astype(np.float32), generator


def make(steps: int = STEPS):  # type: ignore[no-untyped-def]
    """One sub-environment with drag, forces, a torque and its own parameters."""
    env = QuadPendulumVectorEnv(1, wind=WIND, autoreset_mode=AutoresetMode.SAME_STEP, max_episode_steps=steps)
    return VectorParameterWrapper(env, {"share": 0.3})


DELAYED = [ActionDelay(2), MotorLag(0.02)]


def test_a_step_of_the_plant_is_a_step_of_the_environment() -> None:
    """The environment rounds the actions that pass its actuators to float32."""
    env = VectorActuatorWrapper(make(STEPS + 1), DELAYED)
    plant = Plant(Simulation(), moves_air=True, lags=(0.02,), delay=2)
    episode, flight = known_episode(env, 3, STEPS), record_flight(RandomActions(), env, 3, STEPS)
    acting = np.vstack([np.zeros((plant.delay, 4)), flight.actions[: STEPS - plant.delay]])
    states = np.hstack([flight.states, plant.memories(flight.states, acting)])
    x, a, q, y = plant.step()
    known = np.hstack([episode.wind, np.tile(episode.parameters, (STEPS, 1))])
    moved = np.array(ca.Function("step", [x, a, q], [y])(states[:-1].T, acting.T, known.T)).T
    assert_allclose(moved, states[1:], rtol=1e-6, atol=1e-6)


def test_an_optimal_flight_is_flown_by_the_environment_as_planned() -> None:
    env = VectorActuatorWrapper(make(), DELAYED)
    plant = Plant(Simulation(), moves_air=True, lags=(0.02,), delay=2)
    world = env.unwrapped.world
    episode = known_episode(env, 5, STEPS)
    problem = Transcription(plant, world.task.limits, STEPS)
    nothing = Flight(episode.start[np.newaxis], np.zeros((0, 4)))
    solution = problem.solve(episode, *problem.guess(nothing, episode))
    assert solution.status == "Solve_Succeeded"
    assert np.abs(solution.actions).max() <= 1.0
    assert np.all(solution.actions[: plant.delay] == 0.0)
    assert np.all(solution.states[:, 14] >= np.cos(world.task.limits.pendulum_angle))

    policy, memory, errors = track(solution, problem, episode, world), None, []
    observation, _ = env.reset(seed=5)
    for _ in range(STEPS):
        action, memory = policy.predict(observation, memory)
        observation, _, terminated, truncated, info = env.step(action)
        last = info.get("final_info", info)
        errors.append(np.linalg.norm(last["tracking_error"][0]))
    assert not terminated[0]
    assert truncated[0]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(solution.rmse, abs=1e-6)
