"""Wind around an environment: the same model and the same numbers as the keyword ``wind=`` of `gymnasium.make`."""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_gym.wind import as_wind
from quadpend_gym.world import World


def _world(env: Any) -> World:
    world = getattr(env.unwrapped, "world", None)
    if not isinstance(world, World):
        raise TypeError(f"wind can only blow in a QuadPendulum environment, not in {env}")
    return world


class WindWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Let `wind` blow in `env`, besides what blows there already, from the next reset on.

    Args:
        env: a QuadPendulum environment, wrapped or not.
        wind: a model of `quadpend_gym.wind`, a sum of them, or a mapping with its kind.

    Raises:
        TypeError: `env` is another environment, or `wind` is not a wind model.
        ValueError: `wind` is a mapping with an unknown kind or setting.
    """

    def __init__(self, env: gym.Env[Any, Any], wind: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, wind=wind)
        gym.Wrapper.__init__(self, env)
        _world(env).add_wind(as_wind(wind))


class VectorWindWrapper(VectorWrapper, RecordConstructorArgs):
    """`WindWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], wind: Any) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, wind=wind)
        VectorWrapper.__init__(self, env)
        _world(env).add_wind(as_wind(wind))
