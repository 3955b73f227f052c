"""Vector environments on a device: a GPU, or the system's C compiler; `env` needs PyTorch."""

from importlib.util import find_spec
from typing import Any

from gymnasium.vector import VectorEnv

from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv


def make_vector_env(num_envs: int = 1, device: str | None = None, **arguments: Any) -> VectorEnv[Any, Any, Any]:
    """Return a vector environment, on a device a `QuadPendulumDeviceEnv`; `gymnasium.make_vec` calls this."""
    if device is None:
        return QuadPendulumVectorEnv(num_envs, **arguments)
    if find_spec("torch") is None:
        raise ImportError("an environment on a device needs PyTorch: pip install torch")
    from quadpend_gym.device.env import QuadPendulumDeviceEnv

    return QuadPendulumDeviceEnv(num_envs, device=device, **arguments)
