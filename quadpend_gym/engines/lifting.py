"""Read the functions that numba compiles into CasADi's expressions.

A function of Python looks up the names that it uses, such as ``np`` or `sincos`, in a dictionary, its globals. `lift`
copies a function with other globals: functions of CasADi in place of those of NumPy and of `core.elementary`, and
lifted copies of the other functions. The copy computes expressions where the original computes numbers:

    >>> import casadi
    >>> from quadpend_gym.engines import lift
    >>> from quadpend_gym.physics.vectors import Vec3, norm
    >>> x = casadi.SX.sym("x")
    >>> lift(norm)(Vec3(3.0, 4.0 * x, 0.0))
    SX(sqrt(fmax((9+sq((4*x))),1e-200)))

What a function must not do is to choose by the value of an expression: ``if``, ``a if c else b``, ``&`` and ``|``. Take
`core.elementary.select`, `min` and `max`. It may choose by settings, which are numbers. The buffers of the kernels, of
shape (field, lane), are arrays of expressions with one lane, see `columns`.
"""

from collections.abc import Iterable, Mapping
from inspect import unwrap
from types import FunctionType, SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from quadpend_gym.core import elementary

# The slope of a square root at zero is infinite, and the chain rule makes 0 · ∞ of it, for example in the drag at rest.
# With this bound it is zero, and so is the second derivative; the root changes by 1e-100 at most.
_SMALLEST_SQUARE = 1e-200


def _sqrt(x: Any) -> Any:
    return ca.sqrt(ca.fmax(x, _SMALLEST_SQUARE))


def _same(x: Any) -> Any:
    return x


_FUNCTIONS: dict[Any, Any] = {
    elementary.sincos: lambda x: (ca.sin(x), ca.cos(x)),
    elementary.arcsin: ca.asin,
    elementary.arctan2: ca.atan2,
    elementary.log: ca.log,
    elementary.select: ca.if_else,
}
_NUMPY = SimpleNamespace(
    pi=np.pi, sqrt=_sqrt, exp=ca.exp, floor=ca.floor, rint=lambda x: ca.floor(x + 0.5), float32=_same, float64=_same
)
_NUMPY.empty, _NUMPY.empty_like = (lambda shape, *_: np.empty(shape, object)), (lambda a: np.empty(a.shape, object))
_NUMPY.ascontiguousarray = _same


def _least(a: Any, b: Any) -> Any:
    return min(a, b) if isinstance(a, int) and isinstance(b, int) else ca.fmin(a, b)


_BUILTINS = {"max": ca.fmax, "min": _least, "abs": ca.fabs, "float": _same, "bool": _same}


def lift(function: Any, replaced: Mapping[Any, Any] | None = None) -> Any:
    """Return a copy of a function, compiled by numba or not, that computes CasADi's expressions.

    Args:
        function: The function.
        replaced: Functions by the ones, among those that it calls, in whose place they are called.
    """
    return _lift(function, _FUNCTIONS if replaced is None else {**_FUNCTIONS, **replaced})


def _lift(function: Any, known: dict[Any, Any]) -> Any:
    if function not in known:
        source: Any = unwrap(getattr(function, "py_func", function))
        used = {name: source.__globals__[name] for name in source.__code__.co_names if name in source.__globals__}
        names = {name: _lifted(value, known) for name, value in used.items()}
        known[function] = FunctionType(source.__code__, {**_BUILTINS, **names}, source.__name__, source.__defaults__)
    return known[function]


def _lifted(value: Any, known: dict[Any, Any]) -> Any:
    if value is np:
        return _NUMPY
    is_function = hasattr(value, "py_func") or isinstance(value, FunctionType)
    return _lift(value, known) if is_function or (callable(value) and value in known) else value


def columns(values: Any, size: int | None = None) -> Any:
    """Return a (field, lane) buffer with one lane, an array of expressions of shape (size, 1).

    Args:
        values: A vector of CasADi, or numbers, for the first fields; the others are None.
        size: Number of fields, by default that of the values.
    """
    entries = ca.vertsplit(values) if isinstance(values, ca.SX | ca.MX) else list(values)
    buffer = np.empty((size or len(entries), 1), object)
    for field, entry in enumerate(entries):
        buffer[field, 0] = entry
    return buffer


def vector(values: Any) -> Any:
    """Return the entries of a buffer, or of nested tuples, as a vector of CasADi."""
    return ca.vertcat(*_flat(values.ravel() if isinstance(values, np.ndarray) else values))


def _flat(values: Iterable[Any]) -> list[Any]:
    return [x for value in values for x in (_flat(value) if isinstance(value, tuple) else [value])]
