"""The code and the files that other machines need, as one folder: the working directory of the workers there.

It contains the three packages, the modules of the user's own code that this process has imported, and files of the
working directory under the same names. So names of policies, scenarios and files mean the same on every machine. What
is installed in ``site-packages`` is not sent.

The machine code that numba has cached is sent too. Numba uses it if the source files have the same modification times,
which `times` returns.
"""

import hashlib
import os
import shutil
import sys
import sysconfig
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import quadpend_baselines
import quadpend_gym

_PACKAGES = {
    "quadpend_gym": Path(quadpend_gym.__file__).parent,
    "quadpend_baselines": Path(str(quadpend_baselines.__file__)).parent,
    "quadpend_train": Path(__file__).parents[1],
}
_NUMBA = (".nbi", ".nbc")  # suffixes of its cache
_PLUGINS = "quadpend.policies"  # group of entry points
_INSTALLED = ("site-packages", "dist-packages")
_STANDARD = [Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib")]


def write_bundle(folder: Path, files: Iterable[Path]) -> str:
    """Copy code and files into an empty folder.

    Args:
        folder: The folder.
        files: Files of the working directory, by their relative paths.

    Returns:
        A hash of the names, the modification times of the sources, and the contents.

    Raises:
        ValueError: If a file is not in the working directory.
    """
    for name, package in _PACKAGES.items():
        shutil.copytree(package, folder / name, ignore=_without_caches)
    own = _copy_own_modules(folder)
    _write_metadata(folder, own)
    for file in files:
        if file.is_absolute() or os.path.normpath(file).startswith(os.pardir):
            raise ValueError(
                f"a cluster takes files in the working directory by their relative paths, not {file}: copy it to"
                f" {Path.cwd()}"
            )
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(file, folder / file)
    digest = hashlib.sha256(repr(sorted(times(folder).items())).encode())
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(folder)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def times(folder: Path) -> dict[str, int]:
    """Return the modification times (ns) of the source files of the packages in a bundle, by their relative paths."""
    found = [path for name in _PACKAGES for path in (folder / name).rglob("*.py")]
    return {path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in found}


def _without_caches(folder: str, names: list[str]) -> list[str]:
    keep = _NUMBA if os.path.basename(folder) == "__pycache__" else ("",)
    return [name for name in names if name.startswith(".") or not name.endswith(keep)]


def _copy_own_modules(folder: Path) -> set[str]:
    """Copy the imported modules of the user's own code, packages as a whole, and return the names of the outermost."""
    found: set[str] = set()
    for name, module in sys.modules.copy().items():
        top = name.partition(".")[0]
        if top in _PACKAGES or not (file := _own_file(module)):
            continue
        package = _own_file(sys.modules.get(top)) if "." in name or file.name == "__init__.py" else None
        if package is None or package.name != "__init__.py":  # a module, or a part of a namespace package
            target = folder.joinpath(*name.split("."))
            target = target / file.name if file.name == "__init__.py" else target.with_name(file.name)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, target)
        elif top not in found:
            shutil.copytree(package.parent, folder / top, ignore=shutil.ignore_patterns(".*", "__pycache__"))
        found.add(top)
    return found


def _own_file(module: Any) -> Path | None:
    """Return the source file of a module of the user's own code; None for other modules and for a script."""
    name = getattr(module, "__file__", None) if isinstance(module, ModuleType) else None
    if not name or not name.endswith(".py") or module.__name__.startswith("__"):
        return None
    file = Path(name).resolve()
    installed = any(part in _INSTALLED for part in file.parts) or any(map(file.is_relative_to, _STANDARD))
    return None if installed or not file.is_file() else file


def _write_metadata(folder: Path, own: set[str]) -> None:
    """Write the version of the packages, and the plug-ins among own modules, as an installation would."""
    info = folder / f"quadpend_gym-{quadpend_gym.__version__}.dist-info"
    info.mkdir()
    header = f"Metadata-Version: 2.1\nName: quadpend-gym\nVersion: {quadpend_gym.__version__}\n"
    (info / "METADATA").write_text(header, encoding="utf-8")
    points = [point for point in entry_points(group=_PLUGINS) if point.module.partition(".")[0] in own]
    lines = [f"[{_PLUGINS}]", *(f"{point.name} = {point.value}" for point in points), ""]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
