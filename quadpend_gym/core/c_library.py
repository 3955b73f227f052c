"""C sources, compiled by the system's C compiler at the first use.

The library stands in the user's cache folder under the hash of its source, so that every process after the first loads
it within milliseconds. ``XDG_CACHE_HOME`` changes the folder, ``CC`` the compiler.
"""

import os
import subprocess
import tempfile
from hashlib import sha256
from pathlib import Path
from shutil import which

# No contraction of products and sums, so that the numbers are CasADi's to the last bit. No other library replaces the
# functions of this one, so the compiler may inline them, which saves a tenth of the time; nobody reads errno.
_FLAGS = ("-O2", "-ffp-contract=off", "-fno-semantic-interposition", "-fno-math-errno", "-fPIC", "-shared")


def compile_c(source: str) -> Path:
    """Return the library of a C source, from the cache or new.

    Raises:
        RuntimeError: There is no C compiler.
    """
    compiler = os.environ.get("CC", "cc")
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "quadpend_gym"
    library = folder / f"{sha256(' '.join((compiler, *_FLAGS, source)).encode()).hexdigest()[:24]}.so"
    if library.exists():
        return library
    if which(compiler) is None:
        raise RuntimeError(f"C sources need a C compiler, and there is no {compiler!r}: install gcc, or set CC")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as name:
        file, new = Path(name, "generated.c"), Path(name, "generated.so")
        file.write_text(source, encoding="utf-8")
        subprocess.run([compiler, *_FLAGS, "-o", str(new), str(file), "-lm"], check=True)
        os.replace(new, library)
    return library
