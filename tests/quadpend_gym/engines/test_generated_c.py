"""Generated C returns CasADi's numbers to the last bit, from the cache too."""

from pathlib import Path

import casadi
import numpy as np
import pytest

from quadpend_gym import Simulation, engines
from tests.quadpend_gym.engines.inputs import SIMULATIONS, Inputs

ROWS = 20


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("name", ["paper", "body_rates"])
def test_value_and_vector_jacobian_product_are_those_of_casadi(name: str) -> None:
    simulation = SIMULATIONS[name]
    step, x = engines.step_function(simulation, moves_air=True), Inputs(simulation, ROWS)
    seeds = [np.random.default_rng(1).normal(size=(ROWS, step.numel_out(i))) for i in range(2)]
    names = [*step.name_in(), "adj:next_state", "adj:next_memory"]
    product = step.factory("product", names, ["adj:state", "adj:memory", "adj:action"])
    for function, arguments in ((step, x.of_step()), (product, [*x.of_step(), *seeds])):
        found = engines.CompiledFunction(function)(*arguments)
        for row in range(ROWS):
            wanted = function.call([array[row] for array in arguments])
            for result, expected in zip(found, wanted, strict=True):
                np.testing.assert_array_equal(result[row], np.array(expected)[:, 0])


def test_one_argument_may_be_the_same_for_all_rows(cache: Path) -> None:
    function = engines.CompiledFunction(engines.reference_function())
    reference, times = np.arange(20.0), np.linspace(0.0, 1.0, 5)[:, np.newaxis]
    (together,) = function(reference, times)
    for row, time in enumerate(times):
        np.testing.assert_array_equal(together[row], function(reference, time)[0][0])
    (library,) = (cache / "quadpend_gym").iterdir()
    written = library.stat().st_mtime_ns
    engines.CompiledFunction(engines.reference_function())(reference, times)
    assert library.stat().st_mtime_ns == written
    with pytest.raises(ValueError, match="time must have 1 columns, not 2"):
        function(reference, np.zeros(2))
    with pytest.raises(ValueError, match="arguments must have 3 rows"):
        function(np.zeros((2, 20)), np.zeros((3, 1)))


def test_arguments_have_their_zeros() -> None:
    """The adjoint of a result with zeros has as few entries as the result, but rows have all columns."""
    x = casadi.SX.sym("x", 2)
    function = casadi.Function("f", [x], [casadi.vertcat(x[0], casadi.SX(1, 1), x[1])], ["x"], ["y"])
    product = engines.CompiledFunction(function.factory("product", ["x", "adj:y"], ["adj:x"]))
    np.testing.assert_array_equal(product(np.ones((1, 2)), np.array([[1.0, 2.0, 3.0]]))[0], [[1.0, 3.0]])


def test_one_sentence_says_that_a_compiler_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    simulation = Simulation()
    x = Inputs(simulation, 1)
    with pytest.raises(OSError, match="C sources need a C compiler"):
        engines.CompiledFunction(engines.step_function(simulation))(*x.of_step())
