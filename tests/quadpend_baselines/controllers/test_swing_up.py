"""The swing-up: its plan obeys the simulation, and it ends upright at the reference from any direction and in wind."""

from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.recovery import settling_times
from quadpend_baselines import controller
from quadpend_baselines.controllers.swing_up import Phase, read_plan
from quadpend_baselines.policy.protocol import to_command
from quadpend_gym import Simulation, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.wrappers import OutputFeedbackWrapper
from quadpend_train.evaluation.episodes import run_episodes


def test_the_plan_is_a_flight_of_the_simulation_from_hanging_to_upright() -> None:
    states, actions = read_plan()
    simulation = Simulation()
    assert_allclose(State(states[0]).direction, (0.0, 0.0, -1.0), atol=1e-6)
    assert_allclose(State(states[-1]).direction, (0.0, 0.0, 1.0), atol=1e-6)
    for end in (states[0], states[-1]):
        assert_allclose(end[:12], 0.0, atol=1e-6)
        assert_allclose(State(end).direction_rate, 0.0, atol=1e-6)
    assert np.abs(actions).max() <= 0.8 + 1e-6
    parameters = np.tile(simulation.parameters.as_array(), (len(actions), 1))
    following, calm = states[:-1].copy(), np.zeros((len(actions), DISTURBANCE_SIZE))
    advance(following, to_command(actions, simulation), calm, parameters, simulation.period, simulation.substeps)
    assert_allclose(following, states[1:], atol=2e-6)


def times_to_upright(name: str, episodes: int) -> Floats:
    """Return the time after which pendulum and position stay at the goal, s; nan if they do not."""
    results = run_episodes([controller("swing-up")], name, episodes, 1_000_000)
    return settling_times(results.survived, results.error, 0.01)


@pytest.mark.parametrize(("name", "share"), [("swing_up", 0.99), ("swing_up_breeze", 0.95)])
def test_hanging_pendulums_are_upright_within_five_seconds(name: str, share: float) -> None:
    assert np.mean(times_to_upright(name, 100) <= 5.0) >= share


def test_the_pendulum_is_swung_up_from_any_direction() -> None:
    assert np.mean(times_to_upright("swing_up_anywhere", 100) <= 9.0) >= 0.9


def test_most_vehicles_that_are_thrown_in_any_attitude_recover() -> None:
    assert np.mean(times_to_upright("recovery", 100) <= 9.0) >= 0.9


def test_the_phases_follow_one_another_and_begin_again_in_a_new_episode() -> None:
    env = gym.make("QuadPendulumSwingUp-v0")
    policy, memory, phases = controller("swing-up"), None, []
    observation, _ = env.reset(seed=0)
    for _ in range(250):
        action, memory = policy.predict(observation, memory)
        phases.append(int(memory.phase[0]))
        observation, *_ = env.step(action)
    changes = [phases[0], *(after for before, after in pairwise(phases) if after != before)]
    assert changes == [Phase.SWING, Phase.BALANCE]
    observation, _ = env.reset(seed=1)
    _, memory = policy.predict(observation, memory, np.ones(1, np.bool_))
    assert memory.phase[0] == Phase.SWING
    assert memory.step[0] == 0


@pytest.mark.parametrize(
    ("env", "sentence"),
    [
        (lambda: OutputFeedbackWrapper(gym.make("QuadPendulumSwingUp-v0")), "needs an observation with velocities"),
        (lambda: gym.make("QuadPendulumSwingUp-v0", period=0.02), "has a plan for the paper's vehicle"),
    ],
)
def test_what_the_swing_up_cannot_do_is_refused_in_one_sentence(env: Any, sentence: str) -> None:
    made = env()
    simulation = made.unwrapped.world.simulation
    observation, _ = made.reset(seed=0)
    with pytest.raises(ValueError, match=sentence):
        controller("swing-up", simulation).predict(observation)
