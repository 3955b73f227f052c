"""Plain C returns CasADi's numbers to the last bit, also where a function calls another one, without a warning."""

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from shutil import which
from typing import Any

import casadi as ca
import numpy as np
import pytest

from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines.scalar_c import _OPERATIONS, scalar_c

pytestmark = pytest.mark.skipif(which("cc") is None, reason="there is no C compiler")
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wno-unused-parameter", "-Werror", "-ffp-contract=off")
NAMES = ("floor", "sqrt", "sin", "cos", "asin", "atan2", "exp", "expm1", "log", "tanh")
HEAD = """
#include <math.h>
typedef double real;
#define R(x) x
#define q_min fmin
#define q_max fmax
#define q_abs fabs
#define q_sign(x) ((real)((x) > 0) - (real)((x) < 0))
""" + "".join(f"#define q_{name} {name}\n" for name in NAMES)


def compiled(function: Any, folder: Path) -> Callable[[Floats], Floats]:
    """Return a function of CasADi of one argument and with one result, as a C compiler has it."""
    source = folder / "function.c"
    call = f"void run(const real *x, real *y) {{ {function.name()}(x, y); }}\n"
    source.write_text(HEAD + scalar_c(function) + "void run(const real *, real *);\n" + call)
    subprocess.run(["cc", *FLAGS, "-shared", "-fPIC", source, "-o", source.with_suffix(".so"), "-lm"], check=True)
    run, size = ctypes.CDLL(str(source.with_suffix(".so"))).run, function.numel_out(0)

    def evaluate(x: Floats) -> Floats:
        given, found = np.array(x, np.float64), np.empty(size)
        run(*(item.ctypes.data_as(ctypes.c_void_p) for item in (given, found)))
        return found

    return evaluate


def assert_same(function: Any, folder: Path) -> None:
    evaluate, rng = compiled(function, folder), np.random.default_rng(0)
    for _ in range(20):
        x = rng.uniform(0.1, 0.9, function.numel_in(0))
        np.testing.assert_array_equal(evaluate(x), np.array(function(x))[:, 0])


def test_every_operation(tmp_path: Path) -> None:
    x = ca.SX.sym("x", 2)
    results = [
        ca.SX.binary(operation, x[0] - 0.3, x[1]) if "{1}" in text else ca.SX.unary(operation, x[0])
        for operation, text in _OPERATIONS.items()
    ]
    assert_same(ca.Function("each", [x], [ca.vertcat(*results)], ["x"], ["y"]), tmp_path)


@pytest.fixture
def inner() -> Any:
    """A function that is not copied into those that call it."""
    x = ca.SX.sym("x", 3)
    after = ca.vertcat(ca.sin(x[0] * x[1]), x[1] - x[2], ca.sqrt(x[2]))
    return ca.Function("inner", [x], [after], ["x"], ["y"], {"never_inline": True})


def test_calls_in_turn(inner: Any, tmp_path: Path) -> None:
    """As the substeps of a filter: each with the results of the one before, and with a constant among them."""
    x = ca.SX.sym("x", 3)
    state = x
    for _ in range(4):
        state = inner(ca.vertcat(state[2], 0.5, ca.fabs(state[1])))
    outer = ca.Function("outer", [x], [ca.vertcat(state, x[0] * state[0])], ["x"], ["y"])
    assert scalar_c(outer).count("static void") == 2
    assert_same(outer, tmp_path)


def test_results_of_a_call_that_are_not_used(inner: Any, tmp_path: Path) -> None:
    x = ca.SX.sym("x", 3)
    assert_same(ca.Function("outer", [x], [x[0] + inner(x)[1]], ["x"], ["y"]), tmp_path)
