"""Typed doors to numba: `compiled` for what Python calls, `inlined` for what kernels are made of.

`inlined` functions vanish into their caller (LLVM ``alwaysinline``), which is what lets a loop over rows become
vector instructions. `compiled` functions are cached on disk. Numba would only notice when the file of a compiled
function changes, not the files of what it inlines, so the cache is stamped with all of the package's files (but those
of its pictures) and its own.

``fastmath`` stays off: it makes ``isfinite`` lie and the scalar and vectorised loops differ in their last bits.
``error_model="numpy"`` lets a division by zero give inf instead of a branch.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit


def _stamp(file: Path) -> tuple[str, int, int]:
    return file.name, file.stat().st_mtime_ns, file.stat().st_size


_SOURCE_STAMP = tuple(
    _stamp(file) for file in sorted(Path(__file__).parents[1].rglob("*.py")) if file.parent.name != "viewer"
)
Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile `function` for calls from Python, with an on-disk cache."""
    dispatcher: Any = njit(cache=True, error_model="numpy", nogil=True)(function)
    dispatcher._cache._cache_file._source_stamp = (*_SOURCE_STAMP, _stamp(Path(function.__code__.co_filename)))
    return cast(Function, dispatcher)


def inlined(function: Function) -> Function:
    """Compile `function` to be inlined wherever a kernel calls it."""
    return cast(Function, njit(forceinline=True, error_model="numpy")(function))
