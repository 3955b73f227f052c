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
shape (field, lane), are arrays of expressions with one lane, see `columns`. `lift_model` reads the methods of models,
which compute arrays of rows: as arrays of expressions with one row.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from functools import partial
from inspect import unwrap
from types import CodeType, FunctionType, SimpleNamespace
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


def _select(condition: Any, chosen: Any, other: Any) -> Any:
    if isinstance(condition, bool | np.bool_):
        return chosen if condition else other
    return ca.if_else(condition, chosen, other)


_FUNCTIONS: dict[Any, Any] = {
    elementary.sincos: lambda x: (ca.sin(x), ca.cos(x)),
    elementary.arcsin: ca.asin,
    elementary.arctan2: ca.atan2,
    elementary.log: ca.log,
    elementary.select: _select,
}
_LIFTED = dict(_FUNCTIONS)  # and what `lift` has made without other functions


class Rows(np.ndarray):
    """An array of expressions whose comparisons are expressions too; they have no precision."""

    def astype(self, *_: Any, **__: Any) -> Any:
        """Return the expressions as they are."""
        return self

    def __gt__(self, other: Any) -> Any:
        return np.greater(self, other, dtype=object)

    def __lt__(self, other: Any) -> Any:
        return np.less(self, other, dtype=object)

    def __ge__(self, other: Any) -> Any:
        return np.greater_equal(self, other, dtype=object)


def rows(values: Iterable[Any]) -> Rows:
    """Return an array of one row, shape (1, k), of expressions."""
    entries = list(values)
    out = np.empty((1, len(entries)), object).view(Rows)
    for column, entry in enumerate(entries):
        out[0, column] = entry
    return out


def _each(function: Any) -> Any:
    """Return a function of numbers or expressions that is also one of their arrays."""

    def apply(*arguments: Any) -> Any:
        is_array = any(isinstance(item, np.ndarray) for item in arguments)
        return np.frompyfunc(function, len(arguments), 1)(*arguments) if is_array else function(*arguments)

    return apply


def _new(value: Any) -> Callable[..., Rows]:
    def make(shape: Any, *_: Any) -> Rows:
        return np.full(shape, value, object).view(Rows)

    return make


class _Numpy(SimpleNamespace):
    """NumPy with functions of expressions in place of some of those of numbers."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


_NUMPY = _Numpy(
    **{name: _each(getattr(ca, name)) for name in ("exp", "expm1", "floor", "sin", "cos")},
    **{"sqrt": _each(_sqrt), "where": _each(_select), "minimum": _each(ca.fmin), "maximum": _each(ca.fmax)},
    rint=_each(lambda x: ca.floor(x + 0.5)),
    ceil=_each(lambda x: -ca.floor(-x)),
    clip=_each(lambda x, low, high: ca.fmin(ca.fmax(x, low), high)),
    **dict.fromkeys(("float32", "float64", "ascontiguousarray", "asfortranarray"), _same),
    asarray=np.asanyarray,  # keeps `Rows`
    **{"empty": _new(None), "zeros": _new(0.0), "empty_like": lambda a: np.empty(a.shape, object).view(Rows)},
)


def _least(a: Any, b: Any) -> Any:
    return min(a, b) if isinstance(a, int) and isinstance(b, int) else ca.fmin(a, b)


_BUILTINS = {"max": ca.fmax, "min": _least, "abs": ca.fabs, "float": _same, "bool": _same}


def lift(function: Any, replaced: Mapping[Any, Any] | None = None) -> Any:
    """Return a copy of a function, compiled by numba or not, that computes CasADi's expressions.

    Args:
        function: The function.
        replaced: Functions by the ones, among those that it calls, in whose place they are called.
    """
    return _lift(function, _LIFTED if replaced is None else {**_FUNCTIONS, **replaced})


def _lift(function: Any, known: dict[Any, Any], **names: Any) -> Any:
    if function in known:
        return known[function]
    source: Any = unwrap(getattr(function, "py_func", function))
    used = {name: source.__globals__[name] for name in _names(source.__code__) if name in source.__globals__}
    names = {**_BUILTINS, **{name: _lifted(value, known) for name, value in used.items()}, **names}
    lifted = FunctionType(source.__code__, names, source.__name__, source.__defaults__, source.__closure__)
    if "super" not in names:  # else it is a method of one object
        known[function] = lifted
    return lifted


def _names(code: CodeType) -> set[str]:
    """Return the global names that a function uses, in its comprehensions too."""
    inner = (_names(item) for item in code.co_consts if isinstance(item, CodeType))
    return {*code.co_names}.union(*inner)


def _lifted(value: Any, known: dict[Any, Any]) -> Any:
    if value is np:
        return _NUMPY
    is_function = hasattr(value, "py_func") or isinstance(value, FunctionType)
    return _lift(value, known) if is_function or (callable(value) and value in known) else value


def lift_model(model: Any, replaced: Mapping[Any, Any]) -> Any:
    """Return a view of a model or of settings of this package whose methods compute expressions, see `lift`.

    Raises:
        TypeError: The model is of the user's own code, which may do anything.
    """
    return _Model(model, {**_FUNCTIONS, **replaced}, None, None)


class _Model:
    def __init__(self, model: Any, known: dict[Any, Any], instance: Any, after: Any) -> None:
        if not type(model).__module__.startswith("quadpend_gym."):
            raise TypeError(f"{type(model).__name__} is a class of your own code")
        self._model, self._known, self._instance, self._after = model, known, instance or self, after

    def __getattr__(self, name: str) -> Any:
        kinds = type(self._model).__mro__
        for kind in kinds[kinds.index(self._after) + 1 if self._after else 0 :]:
            found = vars(kind).get(name)
            if isinstance(found, FunctionType):
                above = partial(_Model, self._model, self._known, self._instance, kind)
                return partial(_lift(found, self._known, super=above), self._instance)
            if found is not None:
                break
        return self._wrapped(getattr(self._model, name))

    def _wrapped(self, value: Any) -> Any:
        if isinstance(value, tuple) and value and all(map(is_dataclass, value)):
            return [self._wrapped(item) for item in value]
        return lift_model(value, self._known) if is_dataclass(value) else value


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
