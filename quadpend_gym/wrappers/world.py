"""Wrappers that add wind, sensors, actuators and uncertain parameters to an environment.

These wrappers change the simulation of the innermost environment, a `QuadPendulumEnv` or `QuadPendulumVectorEnv`; the
next reset applies the change. Any wrapper in between therefore also receives the changed observations, and the changed
actuators act on its actions. Env and VectorEnv return the same numbers for the same seed.
"""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_gym.actuators import as_actuators
from quadpend_gym.envs.world import World
from quadpend_gym.randomization import as_ranges
from quadpend_gym.scenarios.scenario import wind_models
from quadpend_gym.sensors import as_sensors

AnyEnv = gym.Env[Any, Any] | VectorEnv[Any, Any, Any]


def _world(env: AnyEnv) -> World:
    """Return the simulation of the innermost environment."""
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise TypeError(f"env must be a QuadPendulum environment, wrapped or not, not {env}")
    return world


def add_wind(env: AnyEnv, wind: Any) -> None:
    """Add wind to the simulation of the innermost environment; the next reset applies it, as for the functions below.

    A preset by its name is scaled for the vehicle, see `Scenario.wind`.
    """
    world = _world(env)
    world.add_wind(wind_models(wind, world.simulation))


def add_sensors(env: AnyEnv, sensors: Any) -> None:
    """Add sensors to the simulation of the innermost environment."""
    _world(env).add_sensors(as_sensors(sensors))


def add_actuators(env: AnyEnv, actuators: Any) -> None:
    """Add actuators to the simulation of the innermost environment."""
    _world(env).add_actuators(as_actuators(actuators))


def draw_parameters(env: AnyEnv, ranges: Any) -> None:
    """Let the innermost environment draw its physical parameters for each episode."""
    _world(env).draw_parameters(as_ranges(ranges))


class WindWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Add wind to the wind that `env` already has.

    Args:
        env: A QuadPendulum environment, wrapped or not.
        wind: As the argument of `gymnasium.make`.
    """

    def __init__(self, env: gym.Env[Any, Any], wind: Any) -> None:
        RecordConstructorArgs.__init__(self, wind=wind)
        gym.Wrapper.__init__(self, env)
        add_wind(env, wind)


class VectorWindWrapper(VectorWrapper):
    """`WindWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], wind: Any) -> None:
        VectorWrapper.__init__(self, env)
        add_wind(env, wind)


class SensorWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Compute the observation of `env` from measured states; reward, termination and info do not change.

    Args:
        env: A QuadPendulum environment, wrapped or not. Its own sensors come before these.
        sensors: As the argument of `gymnasium.make`.
    """

    def __init__(self, env: gym.Env[Any, Any], sensors: Any) -> None:
        RecordConstructorArgs.__init__(self, sensors=sensors)
        gym.Wrapper.__init__(self, env)
        add_sensors(env, sensors)


class VectorSensorWrapper(VectorWrapper):
    """`SensorWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], sensors: Any) -> None:
        VectorWrapper.__init__(self, env)
        add_sensors(env, sensors)


class ActuatorWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Pass the actions through actuators before they act on `env`; ``info["command"]`` has the resulting command.

    Args:
        env: A QuadPendulum environment, wrapped or not. An action passes its own actuators after these.
        actuators: As the argument of `gymnasium.make`.
    """

    def __init__(self, env: gym.Env[Any, Any], actuators: Any) -> None:
        RecordConstructorArgs.__init__(self, actuators=actuators)
        gym.Wrapper.__init__(self, env)
        add_actuators(env, actuators)


class VectorActuatorWrapper(VectorWrapper):
    """`ActuatorWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], actuators: Any) -> None:
        VectorWrapper.__init__(self, env)
        add_actuators(env, actuators)


class ParameterWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Draw the physical parameters of each episode; ``info["parameters"]`` has the true values.

    Args:
        env: A QuadPendulum environment, wrapped or not, whose parameters are not drawn yet.
        ranges: As the argument `parameters` of `gymnasium.make`.
    """

    def __init__(self, env: gym.Env[Any, Any], ranges: Any) -> None:
        RecordConstructorArgs.__init__(self, ranges=ranges)
        gym.Wrapper.__init__(self, env)
        draw_parameters(env, ranges)


class VectorParameterWrapper(VectorWrapper):
    """`ParameterWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], ranges: Any) -> None:
        VectorWrapper.__init__(self, env)
        draw_parameters(env, ranges)
