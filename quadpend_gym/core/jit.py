"""Decorators that compile functions with numba: `compiled` to call from Python, `inlined` to call from compiled code.

LLVM copies `inlined` functions into their callers (``alwaysinline``); without this it cannot vectorise a loop over
sub-environments. It assembles them only there, and a call from Python executes them in Python; with a version of numba
newer than the known ones it also assembles them alone, which only takes longer.

The machine code of `compiled` functions is cached on disk. The cache becomes invalid if the file of the function, of
its package or of this package changes. Files of the viewer are ignored, since they contain no compiled code. A damaged
cache is a miss, and replaced.

Numba writes the cache beside the sources, or else to the user's cache folder, or to ``NUMBA_CACHE_DIR``. If it can
write to none of them, there is a warning, and every process compiles the functions again. If compilation takes longer
than two seconds, the logger ``quadpend_gym`` says so once. With ``NUMBA_DISABLE_JIT=1`` Python executes the functions,
with the same results, but slowly.

``fastmath`` is off: it would let the compiler assume that every number is finite, which breaks ``isfinite``, and round
scalar and vectorised loops differently. With ``error_model="numpy"`` a division by zero gives inf, without a branch.
"""

import functools
import logging
import multiprocessing
import time
import warnings
from collections.abc import Callable
from glob import escape
from pathlib import Path
from threading import Timer
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit, version_info
from numba.core import event, types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder

_PATIENCE = 2.0  # s of compilation without a word
_LOGGER = logging.getLogger("quadpend_gym")
_IS_KNOWN = version_info[:2] <= (0, 68)  # the versions whose private parts `_InlinedCompiler` is known to fit


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


def _warn_of_cache(reason: str) -> None:
    way_out = "every process compiles again: set NUMBA_CACHE_DIR to another folder"
    warnings.warn(f"numba cannot write its cache{reason}, so {way_out}", RuntimeWarning, stacklevel=1)


class _Cache(FunctionCache):
    """The cache of one function: what cannot be read is compiled again, what cannot be written is not kept."""

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        # Numba checks only the file of `function`, not the files of the functions inlined into it, and has no public
        # option for more files. This therefore extends the private stamp that numba compares with its cache.
        stamp = _source_stamp(_package_of(Path(function.__code__.co_filename)))
        self._cache_file._source_stamp = (self._cache_file._source_stamp, *stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged pickles raise errors of any type
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            try:
                is_empty = not self._cache_file._load_index()
            except OSError:
                raise
            except Exception:  # the index is damaged
                self.flush()
                is_empty = True
            if is_empty:
                # Numba writes the index first, and gives data the names of older data: if it got no further, because
                # the disk is full or the process killed, the index would declare machine code of older sources valid.
                for old in Path(self.cache_path).glob(f"{escape(self._impl.filename_base)}.*.nbc"):
                    old.unlink(missing_ok=True)
            super().save_overload(sig, data)
        except OSError as error:
            _warn_of_cache(f" ({error.strerror})")


class _Progress(event.Listener):
    """Say once that a process compiles, when this has taken `_PATIENCE` seconds. Processes of a pool say nothing."""

    def __init__(self) -> None:
        self.depth, self.begun, self.spent, self.has_told = 0, 0.0, 0.0, False
        self.timer: Timer | None = None

    def on_start(self, event: Any) -> None:
        """Begin to count with a function that no other one calls; those that it calls are compiled meanwhile."""
        self.depth += 1
        cache = getattr(event.data["dispatcher"], "_cache", None)  # other functions have none, or one of numba's
        if self.depth > 1 or self.has_told or not isinstance(cache, _Cache) or multiprocessing.parent_process():
            return
        self.begun = time.monotonic()
        self.timer = Timer(_PATIENCE - self.spent, self._tell, (cache.cache_path,))
        self.timer.daemon = True
        self.timer.start()

    def on_end(self, event: Any) -> None:
        """Stop counting with the end of that function."""
        self.depth -= 1
        if self.depth == 0 and self.timer:
            self.timer.cancel()
            self.timer.join()
            self.timer = None
            self.spent += time.monotonic() - self.begun

    def _tell(self, folder: str) -> None:
        self.has_told = True
        _LOGGER.warning("quadpend_gym compiles for this machine (once; cached in %s) …", folder)


event.register("numba:compile", _Progress())


class _InlinedLibrary(JITCodeLibrary):
    """The optimised code of an inlined function, for linking: LLVM assembles it as a part of its callers only."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


class _InlinedCompiler(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        self.state.library = _InlinedLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        flags = self.state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]

    def compile_extra(self, func: Callable[..., object]) -> Any:
        """Compile, and give callers an entry point to find the code by, since there is no machine code."""
        result = super().compile_extra(func)._replace(entry_point=object())
        self.state.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])
        return result


Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile `function` for calls from Python, and cache the machine code on disk."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return np.errstate(all="ignore")(function)  # like machine code, do not warn of overflows
    dispatcher: Any = njit(error_model="numpy", nogil=True)(function)
    try:
        dispatcher._cache = _Cache(function)
    except (RuntimeError, AttributeError):  # numba can write no folder, or a later version has other private parts
        _warn_of_cache("")
    return cast(Function, dispatcher)


def inlined(function: Function) -> Function:
    """Compile `function` so that it is inlined into every compiled function that calls it."""
    if config.DISABLE_JIT or not _IS_KNOWN:  # type: ignore[attr-defined]
        return cast(Function, njit(forceinline=True, error_model="numpy")(function))
    dispatcher: Any = njit(forceinline=True, error_model="numpy", pipeline_class=_InlinedCompiler)(function)
    # Numba would compile a function once for each literal number among the arguments, such as the fields of a buffer.
    resolve = dispatcher.get_call_template
    dispatcher.get_call_template = lambda args, kws: resolve(
        [types.unliteral(kind) for kind in args], {name: types.unliteral(kind) for name, kind in kws.items()}
    )
    # A call from Python finds no machine code, and numba then calls what `_compile_for_args` returns.
    dispatcher.add_overload = lambda made: dispatcher.overloads.update({tuple(made.signature.args): made})
    dispatcher._compile_for_args = lambda *_, **__: np.errstate(all="ignore")(function)  # as machine code
    return cast(Function, dispatcher)
