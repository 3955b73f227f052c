"""Device functions for CUDA kernels, compiled from the Python source of the functions that the CPU kernels use.

No equation is copied: `device_function` takes a function that `quadpend_gym.core.jit` compiled, replaces every function
of this package that it calls by its device function, and compiles the same code for the device.
"""

import math
from functools import cache
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import config, cuda

SIMULATED = bool(config.ENABLE_CUDASIM)  # type: ignore[attr-defined]
_PACKAGE = __name__.partition(".")[0]
_OPTIONS = {} if SIMULATED else {"forceinline": True}


# NumPy for the device: numba does not compile these three functions of NumPy for CUDA.
if SIMULATED:
    _NUMPY: ModuleType = np
else:
    from numba.cuda import libdevice

    _NUMPY = ModuleType("numpy")
    vars(_NUMPY).update(vars(np), sqrt=math.sqrt, rint=libdevice.rint, floor=libdevice.floor)


@cache
def device_function(function: Any) -> Any:
    """Return the device function of a compiled or inlined function of this package."""
    original = getattr(function, "py_func", function)
    device = FunctionType(original.__code__, _device_globals(original), original.__name__, original.__defaults__)
    return cuda.jit(device=True, **_OPTIONS)(device)


def _device_globals(function: FunctionType) -> dict[str, Any]:
    """Return the global names that a function reads, with the functions of this package on the device."""
    names = set(function.__code__.co_names)
    found = {name: function.__globals__[name] for name in names if name in function.__globals__}
    return {name: _on_device(value, names) for name, value in found.items()}


def _on_device(value: Any, names: set[str]) -> Any:
    """Return what stands for a global in a device function; `names` are the attributes that the function reads."""
    if value is np:
        return _NUMPY
    if isinstance(value, ModuleType) and value.__name__.startswith(f"{_PACKAGE}."):
        module = ModuleType(value.__name__)
        vars(module).update({name: _on_device(getattr(value, name), names) for name in names if hasattr(value, name)})
        return module
    return device_function(value) if _is_compiled(value) else value


def _is_compiled(value: Any) -> bool:
    """Return whether a global is a function of this package; with ``NUMBA_DISABLE_JIT=1`` it is a plain one."""
    original = getattr(value, "py_func", value)
    return isinstance(original, FunctionType) and original.__module__.startswith(f"{_PACKAGE}.")
