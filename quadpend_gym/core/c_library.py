"""C sources, compiled by the system's C compiler at the first use.

The library stands in the user's cache folder under the hash of its source, so that every process after the first loads
it within milliseconds. ``XDG_CACHE_HOME`` changes the folder, ``CC`` the compiler.
"""

import ctypes
import os
import shlex
import subprocess
import warnings
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

# No contraction of products and sums, so that the numbers are CasADi's to the last bit. No other library replaces the
# functions of this one, so the compiler may inline them, which saves a tenth of the time; nobody reads errno.
_FLAGS = ("-O2", "-ffp-contract=off", "-fno-semantic-interposition", "-fno-math-errno", "-fPIC", "-shared")
# Of what promises no bits: sums in any order, and the instructions of this processor. -ffast-math would change how the
# whole process rounds.
FAST = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math")


def load_c(source: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """Return the library of a C source, from the cache or new, compiled with further flags if it knows them.

    Raises:
        OSError: There is no C compiler, or it fails.
    """
    machine = f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}" if flags else ""
    key = " ".join(
        (os.environ.get("CC", ""), *_FLAGS, *flags, machine, source)
    )  # a library in the cache needs no compiler
    library = cache_path(f"{sha256(key.encode()).hexdigest()[:24]}.so")
    if library.exists():
        with suppress(OSError):  # the file is damaged
            return ctypes.CDLL(str(library))
    with TemporaryDirectory(dir=library.parent) as name:
        file, new = Path(name, "generated.c"), Path(name, "generated.so")
        file.write_text(source, encoding="utf-8")
        try:
            run_compiler([*c_compiler(), *_FLAGS, *flags, "-o", str(new), str(file), "-lm"])
        except OSError:
            if not flags:
                raise
            run_compiler([*c_compiler(), *_FLAGS, "-o", str(new), str(file), "-lm"])
        with new.open("rb+") as made:
            os.fsync(made.fileno())  # a library that a power failure had cut would kill the process that loads it
        os.replace(new, library)
    return ctypes.CDLL(str(library))


def c_compiler() -> list[str]:
    """Return the command of the C compiler: ``CC`` with its arguments, or else the first that is installed."""
    given = os.environ.get("CC") or next(filter(which, ("cc", "gcc", "clang")), "cc")
    try:
        command = [given] if which(given) else shlex.split(given, posix=os.name != "nt")  # "\\" is no escape on Windows
    except ValueError as error:  # a quotation mark is missing
        raise OSError(f"CC is no command: {given!r}: {error}") from error
    if not command or which(command[0]) is None:
        raise OSError(f"C sources need a C compiler, and there is no {given!r}: install gcc, or set CC")
    return command


def run_compiler(command: list[str]) -> None:
    """Compile, and raise an OSError with the compiler's message if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        raise OSError(f"the C compiler fails: {shlex.join(command)}: {done.stderr.strip()}")


def cache_path(name: str) -> Path:
    """Return the path of what is compiled: in the user's cache, or temporary if that has none and cannot be written."""
    with suppress(OSError, RuntimeError):  # RuntimeError: there is no home
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "quadpend_gym"
        if (folder / name).exists():
            return folder / name
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder / name
    way_out = "every process compiles again: set XDG_CACHE_HOME to another folder"
    warnings.warn(f"the cache of compiled C cannot be written, so {way_out}", RuntimeWarning, stacklevel=1)
    return Path(_temporary_folder().name) / name


@cache
def _temporary_folder() -> "TemporaryDirectory[str]":
    """Return a folder that is deleted at the end of the process."""
    return TemporaryDirectory(prefix="quadpend_gym_", ignore_cleanup_errors=True)  # Windows keeps loaded libraries
