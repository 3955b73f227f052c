"""No layout of an action array makes numba compile a kernel again, which takes about ten seconds."""

import gc
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from quadpend_gym import QuadPendulumEnv, QuadPendulumVectorEnv, Simulation, Task, Waypoints
from quadpend_gym.core.arrays import Floats32
from tests.helpers.envs import make, make_vec

RIGID = Simulation(vehicle="hummingbird", interface="body_rates", latency=0.015)
TRAJECTORY = Waypoints((0.0, 3.0), ((0.0, 0.0, 2.0), (0.1, 0.0, 2.0)))
ACTION = np.array([0.1, -0.2, 0.3, 0.0], np.float32)


def _read_only(action: Floats32) -> Any:
    out = action.copy()
    out.flags.writeable = False
    return out


def _strided(action: Floats32) -> Any:
    return np.repeat(action, 2, axis=-1)[..., ::2]


def _misaligned(action: Floats32) -> Any:
    return np.frombuffer(bytearray(b"?" + action.tobytes()), np.float32, offset=1).reshape(action.shape)


LAYOUTS = {
    "read-only": _read_only,
    "Fortran order": np.asfortranarray,
    "strided": _strided,
    "misaligned": _misaligned,
    "float64": lambda action: action.astype(np.float64),
    "list": np.ndarray.tolist,
}


def _signatures() -> dict[str, int]:
    """Return the number of compiled signatures of every kernel of the process."""
    # `isinstance` would ask objects for their class, and deprecated objects of other packages warn of that.
    kernels = [item for item in gc.get_objects() if issubclass(type(item), Dispatcher)]
    return {f"{kernel.py_func.__module__}.{kernel.__name__}": len(kernel.signatures) for kernel in kernels}


def _observations(env: QuadPendulumEnv | QuadPendulumVectorEnv, action: Any) -> Any:
    env.reset(seed=0)
    return env.step(action)[0], env.step(action)[0]


@pytest.mark.parametrize(
    "settings",
    [{}, {"wind": "windy"}, {"simulation": RIGID}, {"task": Task(trajectory=TRAJECTORY)}],
    ids=["plain", "wind", "rigid", "trajectory"],
)
@pytest.mark.parametrize("rows", [0, 3])
def test_no_layout_of_the_action_compiles_a_kernel_again(settings: dict[str, Any], rows: int) -> None:
    """The observations are also the same: with `rows` 0 those of the single environment."""
    env = make_vec(rows, **settings) if rows else make(**settings)
    action = np.tile(ACTION, (rows, 1)) if rows else ACTION
    expected = _observations(env, action)
    before = _signatures()
    for name, layout in LAYOUTS.items():
        np.testing.assert_array_equal(_observations(env, layout(action)), expected, err_msg=name)
    assert _signatures() == before
