"""Functions and classes of the user's own code, named by a text ``"module:factory"``.

Finding a factory executes the code of its module, which is in the working directory or installed.
"""

import importlib
import os
import re
import sys
import traceback
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from quadpend_gym.core.settings import suggest

_NAME = r"[^\W\d]\w*(?:\.[^\W\d]\w*)*"
_FACTORY = re.compile(f"{_NAME}:{_NAME}")


def is_factory(value: Any) -> bool:
    """Return whether `value` is a text of the form ``"module:factory"``, where both may contain dots."""
    return isinstance(value, str) and _FACTORY.fullmatch(value) is not None


def split_text(text: str, sign: str) -> list[str]:
    """Split a text at every sign that is not in the path of an existing file or folder, with a member or without."""
    parts, rest = [], text.split(sign)
    while rest:
        beginnings = {n: sign.join(rest[:n]) for n in range(len(rest), 0, -1)}
        count = next((n for n, path in beginnings.items() if _exists(path)), 1)
        parts.append(beginnings[count])
        rest = rest[count:]
    return parts


def _exists(path: str) -> bool:
    """Return whether there is a file or folder of this name, without ":member" behind or "lqg:" before it."""
    return any(map(os.path.exists, (path, path.rpartition(":")[0], re.sub(r"^[\w-]+:", "", path))))


def split_name(text: str) -> tuple[str, str]:
    """Split NAME=VALUE; without a name, it is empty. A name has no slash, and an existing path has no name."""
    name, sign, value = text.partition("=")
    beginnings = (text[: end.start()] for end in re.finditer("[,@]|$", text))  # the first of several, or of a vehicle's
    is_path = any("=" in beginning and _exists(beginning) for beginning in beginnings)
    return (name, value) if sign and "/" not in name and not is_path else ("", text)


def find_factory(name: str) -> Callable[..., Any]:
    """Return the function or class with a name of the form ``"module:factory"``."""
    module_name, _, attribute = name.partition(":")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())  # as with `python -m`; the installed command `quadpend` does not add it
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # the module may raise exceptions of any type, and end the program
        missing = getattr(error, "name", None)
        if isinstance(error, ModuleNotFoundError) and f"{module_name}.".startswith(f"{missing}."):
            raise ValueError(f"there is no module {missing!r} in {os.getcwd()} or the installed packages") from error
        raise ValueError(f"the module {module_name!r} cannot be imported: {describe_error(error)}") from error
    try:
        found: Any = attrgetter(attribute)(module)
    except AttributeError:
        raise ValueError(f"the module {module_name!r} has no {attribute!r}{suggest(attribute, dir(module))}") from None
    if not callable(found):
        raise ValueError(f"{name} must be a function or a class, not {found!r}")
    return found  # type: ignore[no-any-return]


def call_factory(name: str, factory: Callable[..., Any], *arguments: Any) -> Any:
    """Return what the factory with a name returns; its errors become a ValueError with the name."""
    try:
        return factory(*arguments)
    except Exception as error:  # the factory may raise exceptions of any type
        raise ValueError(f"{name} failed: {describe_error(error)}") from error


def describe_error(error: BaseException) -> str:
    """Return type, message and place of an exception, such as "KeyError: 'x' (mine.py, line 7)"."""
    frames = [one for one in traceback.extract_tb(error.__traceback__) if not one.filename.startswith("<frozen")]
    place = f" ({os.path.basename(frames[-1].filename)}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}" + ("" if isinstance(error, SyntaxError) else place)
