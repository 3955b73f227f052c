"""Decorators that compile functions with numba: `compiled` to call from Python, `inlined` to call from compiled code.

LLVM copies `inlined` functions into their callers (``alwaysinline``); without this it cannot vectorise a loop over
sub-environments. The machine code of `compiled` functions is cached on disk. The cache becomes invalid if the file of
the function or a source file of this package changes. Files of the viewer are ignored, since they contain no compiled
code.

``fastmath`` is off: it would let the compiler assume that every number is finite, which breaks ``isfinite``, and round
scalar and vectorised loops differently. With ``error_model="numpy"`` a division by zero gives inf, without a branch.
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
    """Compile `function` for calls from Python, and cache the machine code on disk."""
    dispatcher: Any = njit(cache=True, error_model="numpy", nogil=True)(function)
    # Numba checks only the file of `function`, not the files of the functions inlined into it, and has no public option
    # for more files. This therefore replaces the private stamp that numba compares with its cache.
    dispatcher._cache._cache_file._source_stamp = (*_SOURCE_STAMP, _stamp(Path(function.__code__.co_filename)))
    return cast(Function, dispatcher)


def inlined(function: Function) -> Function:
    """Compile `function` so that it is inlined into every compiled function that calls it."""
    return cast(Function, njit(forceinline=True, error_model="numpy")(function))
