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


def _add_wind(env: AnyEnv, wind: Any) -> None:
    world = _world(env)
    world.add_wind(wind_models(wind, world.simulation))


def _add_sensors(env: AnyEnv, sensors: Any) -> None:
    _world(env).add_sensors(as_sensors(sensors))


def _add_actuators(env: AnyEnv, actuators: Any) -> None:
    _world(env).add_actuators(as_actuators(actuators))


def _draw_parameters(env: AnyEnv, ranges: Any) -> None:
    _world(env).draw_parameters(as_ranges(ranges))


class WindWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Add wind to the wind that `env` already has.

    Args:
        env: A QuadPendulum environment, wrapped or not.
        wind: A model of `quadpend_gym.wind`, a sum of models, the name of a preset, or a mapping with a ``kind``.

    Raises:
        TypeError: If `env` is another environment, or `wind` is not a wind model.
        ValueError: If `wind` has an unknown name, kind or setting, or a setting out of range.
    """

    def __init__(self, env: gym.Env[Any, Any], wind: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, wind=wind)
        gym.Wrapper.__init__(self, env)
        _add_wind(env, wind)


class VectorWindWrapper(VectorWrapper):
    """`WindWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], wind: Any) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        _add_wind(env, wind)


class SensorWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Compute the observation of `env` from measured states instead of the true ones.

    The sensors of an outer wrapper are applied to the output of the sensors of an inner one. Reward, termination and
    info do not change.

    Args:
        env: A QuadPendulum environment, wrapped or not.
        sensors: A model of `quadpend_gym.sensors`, a mapping with a ``kind``, or a list of these in the order in which
            they are applied.

    Raises:
        TypeError: If `env` is another environment, or `sensors` are not sensor models.
        ValueError: If a kind or setting is unknown, or a setting is out of range.
    """

    def __init__(self, env: gym.Env[Any, Any], sensors: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, sensors=sensors)
        gym.Wrapper.__init__(self, env)
        _add_sensors(env, sensors)


class VectorSensorWrapper(VectorWrapper):
    """`SensorWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], sensors: Any) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        _add_sensors(env, sensors)


class ActuatorWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Pass the actions through actuators before they act on `env`; ``info["command"]`` has the resulting command.

    An action passes the actuators of an outer wrapper before those of an inner one.

    Args:
        env: A QuadPendulum environment, wrapped or not.
        actuators: A model of `quadpend_gym.actuators`, a mapping with a ``kind``, or a list of these in the order in
            which an action passes them.

    Raises:
        TypeError: If `env` is another environment, or `actuators` are not actuator models.
        ValueError: If a kind or setting is unknown, a setting is out of range, or the models do not fit together in
            this order.
    """

    def __init__(self, env: gym.Env[Any, Any], actuators: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, actuators=actuators)
        gym.Wrapper.__init__(self, env)
        _add_actuators(env, actuators)


class VectorActuatorWrapper(VectorWrapper):
    """`ActuatorWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], actuators: Any) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        _add_actuators(env, actuators)


class ParameterWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Draw the physical parameters of each episode; ``info["parameters"]`` has the true values.

    Args:
        env: A QuadPendulum environment, wrapped or not.
        ranges: `ParameterRanges`, `Around` for ranges around the parameters of `env`, or a mapping of the fields of
            either.

    Raises:
        TypeError: If `env` is another environment, or `ranges` is not of these types.
        ValueError: If a parameter is unknown, a range is out of order, or `env` already has a `ParameterWrapper`.
    """

    def __init__(self, env: gym.Env[Any, Any], ranges: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, ranges=ranges)
        gym.Wrapper.__init__(self, env)
        _draw_parameters(env, ranges)


class VectorParameterWrapper(VectorWrapper):
    """`ParameterWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], ranges: Any) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        _draw_parameters(env, ranges)
