"""Decorators that compile functions with numba: `compiled` to call from Python, `inlined` to call from compiled code.

LLVM copies `inlined` functions into their callers (``alwaysinline``); without this it cannot vectorise a loop over
sub-environments. The machine code of `compiled` functions is cached on disk. The cache becomes invalid if the file of
the function, of its package or of this package changes. Files of the viewer are ignored, since they contain no compiled
code.

Numba writes the cache beside the sources, or else to the user's cache folder, or to ``NUMBA_CACHE_DIR``. If it can
write to none of them, there is a warning, and every process compiles the functions again. With
``NUMBA_DISABLE_JIT=1`` Python executes the functions, with the same results, but slowly.

``fastmath`` is off: it would let the compiler assume that every number is finite, which breaks ``isfinite``, and round
scalar and vectorised loops differently. With ``error_model="numpy"`` a division by zero gives inf, without a branch.
"""

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit


def _stamp(file: Path) -> tuple[str, int, int]:
    return file.name, file.stat().st_mtime_ns, file.stat().st_size


@functools.cache
def _source_stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Return the stamp of the sources in a folder, and of those of this package."""
    folders = {Path(__file__).parents[1], folder}
    files = sorted(file for top in folders for file in top.rglob("*.py") if file.parent.name != "viewer")
    return tuple(_stamp(file) for file in files)


def _package_of(file: Path) -> Path:
    """Return the folder of the top package that a file belongs to, or the file's own folder."""
    folder = file.parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile `function` for calls from Python, and cache the machine code on disk."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return np.errstate(all="ignore")(function)  # like machine code, do not warn of overflows
    dispatcher: Any = njit(error_model="numpy", nogil=True)(function)
    try:
        dispatcher.enable_caching()
    except RuntimeError:  # there is no folder that numba can write
        message = "numba cannot write its cache, so every process compiles again: set NUMBA_CACHE_DIR to another folder"
        warnings.warn(message, RuntimeWarning, stacklevel=1)
        return cast(Function, dispatcher)
    # Numba checks only the file of `function`, not the files of the functions inlined into it, and has no public option
    # for more files. This therefore replaces the private stamp that numba compares with its cache.
    file = Path(function.__code__.co_filename)
    dispatcher._cache._cache_file._source_stamp = (*_source_stamp(_package_of(file)), _stamp(file))
    return cast(Function, dispatcher)


def inlined(function: Function) -> Function:
    """Compile `function` so that it is inlined into every compiled function that calls it."""
    return cast(Function, njit(forceinline=True, error_model="numpy")(function))
