"""Functions of CasADi as C for batches of rows, compiled by the system's C compiler at the first use."""

import ctypes
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.c_library import load_c

_NAME = "quadpend_generated"
_ROWS = """
void rows(long long count, const double** in, const long long* in_step, double** out, const long long* out_step) {{
  static __thread casadi_int iw[{iw} + 1];
  static __thread casadi_real w[{w} + 1];
  const double* arg[{arg} + 1];
  double* res[{res} + 1];
  for (long long row = 0; row < count; ++row) {{
    for (int i = 0; i < {inputs}; ++i) arg[i] = in[i] + row * in_step[i];
    for (int i = 0; i < {outputs}; ++i) res[i] = out[i] + row * out_step[i];
    {name}(arg, res, iw, w, 0);
  }}
}}
"""


class CompiledFunction:
    """A function of CasADi, compiled to machine code, for arrays of rows.

    A call releases Python's global lock, so several threads may call one function at once.

    Args:
        function: A function of vectors, for example one of `quadpend_gym.engines.functions` or its derivative.
    """

    def __init__(self, function: Any) -> None:
        self.function = _dense(function)
        self._inputs = [self.function.numel_in(i) for i in range(self.function.n_in())]
        self._outputs = [self.function.numel_out(i) for i in range(self.function.n_out())]
        self._pointers = ctypes.c_void_p * len(self._inputs), ctypes.c_void_p * len(self._outputs)
        self._steps = ctypes.c_longlong * len(self._inputs), ctypes.c_longlong * len(self._outputs)
        self._out_steps = self._steps[1](*self._outputs)

    @cached_property
    def source(self) -> str:
        """The C source: the function, and a loop over rows."""
        function = self.function
        generator = ca.CodeGenerator("generated", {"with_header": False})
        generator.add(function)
        sizes = {"arg": function.sz_arg(), "res": function.sz_res(), "iw": function.sz_iw(), "w": function.sz_w()}
        counts = {"inputs": function.n_in(), "outputs": function.n_out()}
        return str(generator.dump()) + _ROWS.format(name=_NAME, **sizes, **counts)

    @cached_property
    def _rows(self) -> Any:
        return load_c(self.source).rows

    def __call__(self, *arguments: Floats) -> tuple[Floats, ...]:
        """Return the results of n rows, each of shape (n, size).

        Args:
            *arguments: The arguments of the function, each of shape (n, size), or (size,) if all rows have the same.
        """
        arrays = [np.ascontiguousarray(argument, np.float64) for argument in arguments]
        for i, (array, size) in enumerate(zip(arrays, self._inputs, strict=True)):
            if array.shape[-1] != size:
                name = self.function.name_in(i)
                raise ValueError(f"{name} must have {size} columns, not {array.shape[-1]}")
        count = max((len(array) for array in arrays if array.ndim == 2), default=1)
        if any(array.ndim == 2 and len(array) != count for array in arrays):
            raise ValueError(f"arguments must have {count} rows, or one dimension, not {[len(a) for a in arrays]} rows")
        results = [np.empty((count, size)) for size in self._outputs]
        pointers = (
            self._pointers[0](*(a.ctypes.data for a in arrays)),
            self._pointers[1](*(a.ctypes.data for a in results)),
        )
        in_steps = self._steps[0](*(size if a.ndim == 2 else 0 for a, size in zip(arrays, self._inputs, strict=True)))
        self._rows(ctypes.c_longlong(count), pointers[0], in_steps, pointers[1], self._out_steps)
        return tuple(results)


def _dense(function: Any) -> Any:
    """Return a function whose arguments and results have all their zeros."""
    arguments = [ca.SX.sym(function.name_in(i), function.numel_in(i)) for i in range(function.n_in())]
    results = [ca.densify(result) for result in function.call(arguments)]
    # A name of its own: the loader would prefer functions of the same name in other libraries, such as step in libc.
    return ca.Function(_NAME, arguments, results, function.name_in(), function.name_out())
