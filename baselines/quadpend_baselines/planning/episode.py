"""What a clairvoyant knows about an episode, and flights of policies as first guesses of its optimal flight.

Start, parameters and reference are drawn at the start of an episode, and no wind model reads the state. So wind and
reference of a whole episode are the same in every flight, and any flight reveals them.
"""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines.policy.protocol import Policy
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs.outcome import TRACKING_ERROR
from quadpend_gym.envs.world import world_of
from quadpend_gym.physics.state import ACTION_SIZE, State
from quadpend_gym.vehicles.parameters import ROD_LENGTH

AnyVectorEnv = VectorEnv[Any, Any, Any]


class KnownEpisode(NamedTuple):
    """An episode of N control steps, without the actions."""

    start: Floats  # first state, shape (18,)
    parameters: Floats  # physical parameters in the order of `Parameters.as_array`, shape (9,)
    wind: Floats  # wind over each control period, laid out as in `quadpend_gym.wind`, shape (N, 12)
    target: Floats  # point to track after each step: x and y of the bob and height of the quadrotor, m, shape (N, 3)


class Flight(NamedTuple):
    """States and actions of a flight of n steps, which ends early if it falls."""

    states: Floats  # shape (n + 1, 18)
    actions: Floats  # actions of the policy, shape (n, 4)


def tracked_point(state: Floats, parameters: Floats) -> Floats:
    """Return x and y of the bob and the height of the quadrotor, m, shape (..., 3), of states, shape (..., 18)."""
    s = State(state)
    bob = s.position + parameters[ROD_LENGTH] * s.direction
    return np.concatenate([bob[..., :2], s.position[..., 2:]], axis=-1)


def known_episode(env: AnyVectorEnv, seed: int, steps: int) -> KnownEpisode:
    """Return the episode that a seed draws in a vector environment with one sub-environment, for N control steps."""
    env.reset(seed=seed)
    world = world_of(env)
    start, parameters = world.state[0].copy(), world.parameters[0].copy()
    hover, wind, target = np.zeros((1, ACTION_SIZE), np.float32), [], []
    for _ in range(steps):
        wind.append(world.wind[0].copy())
        _, outcome = world.step(hover)
        target.append(tracked_point(world.state[0], parameters) - outcome[TRACKING_ERROR, 0])
    return KnownEpisode(start, parameters, np.array(wind), np.array(target))


def record_flight(policy: Policy, env: AnyVectorEnv, seed: int, steps: int) -> Flight:
    """Return the flight of a policy in one sub-environment whose episodes are longer than `steps`."""
    observation, _ = env.reset(seed=seed)
    world = world_of(env)
    states, actions, memory, start = [world.state[0].copy()], [], None, np.ones(1, np.bool_)
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, start)
        observation, _, terminated, _, _ = env.step(action)
        if terminated[0]:  # after the autoreset, the state is that of the next episode
            break
        start = np.zeros(1, np.bool_)
        states.append(world.state[0].copy())
        actions.append(action[0].astype(np.float64))
    return Flight(np.array(states), np.array(actions).reshape(-1, ACTION_SIZE))
