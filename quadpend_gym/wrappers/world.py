"""Wind, sensors, actuators and uncertain parameters around an environment.

These wrappers change the world underneath, `QuadPendulumEnv` or `QuadPendulumVectorEnv`, from the next reset on; other
wrappers in between see the changed observations and act through the changed actuators. Env and VectorEnv get the same
numbers for the same seed.
"""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_gym.actuators import as_actuators
from quadpend_gym.envs.world import World
from quadpend_gym.randomization import as_ranges
from quadpend_gym.sensors import as_sensors
from quadpend_gym.wind import as_wind

AnyEnv = gym.Env[Any, Any] | VectorEnv[Any, Any, Any]


def _world(env: AnyEnv) -> World:
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise TypeError(f"only a QuadPendulum environment can be wrapped so, not {env}")
    return world


def _add_wind(env: AnyEnv, wind: Any) -> None:
    _world(env).add_wind(as_wind(wind))


def _add_sensors(env: AnyEnv, sensors: Any) -> None:
    _world(env).add_sensors(as_sensors(sensors))


def _add_actuators(env: AnyEnv, actuators: Any) -> None:
    _world(env).add_actuators(as_actuators(actuators))


def _draw_parameters(env: AnyEnv, ranges: Any) -> None:
    _world(env).draw_parameters(as_ranges(ranges))


class WindWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Let `wind` blow in `env`, besides what blows there already.

    Args:
        env: a QuadPendulum environment, wrapped or not.
        wind: a model of `quadpend_gym.wind`, a sum of them, the name of a preset, or a mapping with its kind.

    Raises:
        TypeError: `env` is another environment, or `wind` is not a wind model.
        ValueError: `wind` names something unknown, or has an unknown setting or one out of range.
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
    """Observe `env` through sensors; those of an outer wrapper work on what those of an inner one measured.

    Args:
        env: a QuadPendulum environment, wrapped or not.
        sensors: a model of `quadpend_gym.sensors`, a mapping with its kind, or a list of these, in order.

    Raises:
        TypeError: `env` is another environment, or `sensors` are not sensor models.
        ValueError: a kind or setting is unknown or out of range.
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
    """Act on `env` through actuators; an action passes those of an outer wrapper first.

    Args:
        env: a QuadPendulum environment, wrapped or not.
        actuators: a model of `quadpend_gym.actuators`, a mapping with its kind, or a list of these, in order.

    Raises:
        TypeError: `env` is another environment, or `actuators` are not actuator models.
        ValueError: a kind or setting is unknown or out of range, or the models make no sense in this order.
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
    """Draw the physical parameters of each episode; ``info["parameters"]`` tells the true ones.

    Args:
        env: a QuadPendulum environment, wrapped or not.
        ranges: `ParameterRanges`, or `Around` for a share of the parameters of `env`, or a mapping of the fields of
            either.

    Raises:
        TypeError: `env` is another environment, or `ranges` are none.
        ValueError: a parameter is unknown, a range is out of order, or the parameters of `env` are drawn already.
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
