"""Controllers of a hanging load: the mirrored design, the poles of the swing, and tracking."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_baselines import controller
from quadpend_baselines.controllers.hanging import mirror_observation, mirror_simulation
from quadpend_baselines.controllers.lqr import riccati
from quadpend_baselines.gains import HANGING_GAINS
from quadpend_baselines.hybrid import HybridWrapper, ResidualAction
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, linearise
from quadpend_gym import Reference, Simulation, State, Task, Waypoints
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.policies.loading import load_policies
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


def test_the_observation_is_mirrored_and_the_given_one_unchanged() -> None:
    env = gym.make(LOAD)
    observation, _ = env.reset(seed=0)
    before = observation.copy()
    assert_allclose(mirror_observation(mirror_observation(observation)), before)
    assert np.flatnonzero(mirror_observation(observation) != observation).tolist() == [6, 7, 8, 9, 10, 11]
    np.testing.assert_array_equal(observation, before)


def flight(name: str, start: dict[str, object], steps: int) -> Floats:
    """Return the states of a flight about the hover reference, shape (steps + 1, 18)."""
    env = gym.make(LOAD)
    observation, _ = env.reset(seed=0, options={"state": start, "reference": Reference.hover()})
    policy, memory = controller(name).adapt(Scenario(task="load")), None
    states = [env.unwrapped.state.array.copy()]  # type: ignore[attr-defined]
    for _ in range(steps):
        action, memory = policy.predict(observation, memory)
        observation, *_ = env.step(action)
        states.append(env.unwrapped.state.array.copy())  # type: ignore[attr-defined]
    return np.array(states)


def test_the_swing_of_the_load_decays_as_the_linear_theory_says() -> None:
    """x_{k+1} = (A − B K) x_k, with the matrices of the mirrored model."""
    swing = {**AT_REST, "direction": (0.01, 0.0, -1.0)}
    states = flight("lqr", swing, 200)
    mirrored = mirror_simulation(Simulation())
    A, B, _ = linearise(mirrored)
    gain, _ = riccati(HANGING_GAINS["lqr"], mirrored)
    x = states - State(np.zeros(STATE_SIZE)).array
    x[:, 2] -= 2.0
    x[:, 12:] *= -1.0
    expected = [x[0, STATE_COLUMNS]]
    for _ in range(200):
        expected.append((A - B @ gain) @ expected[-1])
    found, linear = x[:, STATE_COLUMNS][:, 12], np.array(expected)[:, 12]
    assert np.abs(found - linear).max() < 0.02 * np.abs(linear).max()
    assert np.abs(found[150:]).max() < 0.2 * np.abs(found).max()  # it is damped


def test_an_uncontrolled_load_swings_with_the_frequency_of_theory() -> None:
    """With level hover thrust, the pendulum of the length l swings with √((M + m_c) g/(M l))."""
    simulation = Simulation()
    p = simulation.parameters
    state = np.zeros((1, STATE_SIZE))
    State(state).direction[:] = 0.01, 0.0, -np.sqrt(1.0 - 1e-4)
    parameters, command = p.as_array()[np.newaxis], np.array([[p.hover_thrust, 0.0, 0.0, 0.0]])
    times, swing = 1e-3 * np.arange(1, 3001), []
    for _ in times:
        advance(state, command, np.zeros((1, DISTURBANCE_SIZE)), parameters, 1e-3, 1)
        swing.append(state[0, 12])
    assert_allclose(swing, 0.01 * np.cos(np.sqrt(p.chain_stiffness) * times), atol=2e-5)


@pytest.mark.parametrize("name", ["flatness", "lqr"])
def test_the_load_tracks_references_in_calm_air(name: str) -> None:
    results = run_episodes([controller(name)], Scenario(task="load"), 20, 7)
    assert results.survived.all()
    assert results.settled_rmse.max() < 1e-3


@pytest.mark.parametrize(
    ("name", "vehicle", "sentence"),
    [
        ("adrc-paper", "paper", "only flatness, lqr, lqi, dual-mode and mppi fly a load"),
        ("swing-up", "paper", "only flatness"),
        ("lqr", "hummingbird", "for the paper's vehicle, not 'hummingbird'"),
    ],
)
def test_what_no_controller_of_a_load_does_is_refused_in_one_sentence(name: str, vehicle: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        controller(name).adapt(Scenario(task="load", vehicle=vehicle))


def test_a_hybrid_and_a_load_are_refused_in_one_sentence() -> None:
    with pytest.raises(ValueError, match="hybrids balance an upright pendulum"):
        HybridWrapper(gym.make(LOAD), ResidualAction("lqr"))
    with pytest.raises(ValueError, match="hybrids balance an upright pendulum"):
        run_episodes(load_policies("ppo-gain-scheduling-0"), Scenario(task="load"), 1, 7)


def test_the_ground_below_a_load_counts_in_the_check_of_a_trajectory() -> None:
    low = Waypoints((0, 3), ((0, 0, 2.0), (0, 0, 0.2)))
    with pytest.warns(UserWarning, match="reaches a height of -0.10 m"):
        gym.make(LOAD, task=Task(trajectory=low, pendulum="hanging"))
