"""Compile the kernels that tests need, once before several processes run the tests."""

from typing import Any

import numpy as np

from quadpend_baselines import controller
from quadpend_baselines.policy.protocol import to_command
from quadpend_gym import PAPER, Reference, Simulation, Sinusoids
from quadpend_gym.physics.dynamics import accelerations
from tests.helpers.controllers import AVAILABLE_CONTROLLERS, HOVER, flat_state_and_command
from tests.helpers.envs import make, make_vec
from tests.helpers.physics import random_commands, random_disturbances, random_states, simulate_period
from tests.helpers.wind import EXAMPLES
from tests.helpers.wrappers import STACKS, wrapped

RIGID = Simulation(vehicle="hummingbird", interface="body_rates", latency=0.015)
TRAJECTORY = Sinusoids(terms=({"amplitude": (0.1, 0.0, 0.0, 0.0), "frequency": (1.0, 0.0, 0.0, 0.0)},))


def observe_step(env: Any, reference: Any = None) -> Any:
    """Return the observation after a step."""
    env.reset(seed=0, options={"reference": reference} if reference else None)
    return env.step(env.action_space.sample())[0]


def compile_kernels() -> None:
    """Call every kernel with one row and with several rows, whose arrays can have another memory layout."""
    for layers in STACKS.values():
        for env in (wrapped(make(), layers), wrapped(make_vec(3), layers)):
            observe_step(env)
    for wind in EXAMPLES.values():
        for env in (make(wind=wind), make_vec(3, wind=wind)):
            observation = observe_step(env)
    for name in AVAILABLE_CONTROLLERS:
        controller(name).predict(observation)
    flatness = controller("flatness", RIGID)
    for simulation in (Simulation(), RIGID):
        for reference in (Reference.hover(2.0), TRAJECTORY):
            for env in (make(simulation=simulation), make_vec(3, simulation=simulation)):
                observation = observe_step(env, reference)
    _, memory = flatness.predict(observation)
    action, _ = flatness.predict(observation, memory)
    to_command(action, RIGID)
    for rows in (1, 3):
        state, command, wind = random_states(rows, 0), random_commands(rows, 0, PAPER), random_disturbances(rows, 0)
        accelerations(state, command, wind, PAPER)
        simulate_period(state, command, wind, PAPER, 0.01, 1)
    flat_state_and_command(HOVER, 0.0, np.zeros(9), PAPER)


if __name__ == "__main__":
    compile_kernels()
