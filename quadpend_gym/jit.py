"""Typed doors to numba: `compiled` for what Python calls, `inlined` for what kernels are made of.

`inlined` functions vanish into their caller (LLVM ``alwaysinline``), which is what lets a loop over rows become
vector instructions. `compiled` functions are cached on disk; numba does not notice when a function they inline changes
in another file, so run ``make clean`` after editing one.

``fastmath`` stays off: it makes ``isfinite`` lie and the scalar and vectorised loops differ in their last bits.
``error_model="numpy"`` lets a division by zero give inf instead of a branch.
"""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile `function` for calls from Python, with an on-disk cache."""
    return cast(Function, njit(cache=True, error_model="numpy", nogil=True)(function))


def inlined(function: Function) -> Function:
    """Compile `function` to be inlined wherever a kernel calls it."""
    return cast(Function, njit(forceinline=True, error_model="numpy")(function))
