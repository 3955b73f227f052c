"""The functions of CasADi compute what the compiled step of the environments computes, and have its derivatives."""

from typing import Any

import numpy as np
import pytest

from quadpend_gym import Simulation, engines
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs import kernel_layout as layout
from quadpend_gym.envs import outcome as places
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.envs.step_kernel import KERNELS, STEP
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.tasks.observation import ALL
from quadpend_gym.tasks.references import POINT_SIZE
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles.parameters import BOB_MASS, ROD_LENGTH
from tests.quadpend_gym.engines.inputs import SIMULATIONS, Inputs

ROWS = 1000
TASK = TASKS["track"]


def call(function: Any, *arguments: Floats) -> list[Floats]:
    """Return the results of a function for n rows, each of shape (n, size)."""
    rows = len(arguments[0])
    return [np.array(result).T for result in function.map(rows).call([array.T for array in arguments])]


NO_HAND = np.zeros((ROWS, 4))


def step_by_numba(simulation: Simulation, x: Inputs, hand: Floats = NO_HAND) -> tuple[Floats, Floats, Floats, Floats]:
    """Return next state, next memory, observation and outcome of the compiled step."""
    rows, plant = len(x.state), plant_of(simulation)
    schedule = Schedule(None, simulation, rows)
    outcome = np.zeros((places.OUTCOME_SIZE, rows))
    memory = np.hstack([np.zeros((rows, layout.MEMORY_SIZE)), x.memory])
    memory[:, layout.MEMORY_STATE], memory[:, layout.MEMORY_PARAMETERS] = x.state, x.parameters
    memory[:, layout.MEMORY_REFERENCE] = x.reference
    memory[:, layout.MEMORY_POLE] = x.parameters[:, [ROD_LENGTH, BOB_MASS]]
    observation = np.zeros((rows, ALL.size), np.float32)
    settings = layout.pack_settings(TASK, plant, moves_air=True, has_sensors=False)
    columns = np.ascontiguousarray(np.hstack([x.wind, hand]).T)
    inputs = memory, np.zeros(rows, np.int64), columns, np.asarray(x.action, np.float32)
    numbers = schedule.loops, np.zeros((POINT_SIZE, 0)), settings
    kernel = plant.held_kernel if hand.any() else plant.kernel
    KERNELS[kernel](STEP, *inputs, *numbers, observation, outcome, 0, rows)
    return memory[:, layout.MEMORY_STATE], memory[:, layout.MEMORY_SIZE :], observation, outcome


@pytest.mark.parametrize("name", SIMULATIONS)
def test_a_step_is_that_of_the_environment(name: str) -> None:
    simulation = SIMULATIONS[name]
    x = Inputs(simulation, ROWS)
    state, memory, _, _ = step_by_numba(simulation, x)
    next_state, next_memory = call(engines.step_function(simulation, moves_air=True), *x.of_step())
    np.testing.assert_allclose(next_state, state, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(next_memory, memory, rtol=1e-13, atol=1e-13)


def test_a_step_with_a_hand_is_that_of_the_environment() -> None:
    simulation = SIMULATIONS["latency"]
    x, hand = Inputs(simulation, ROWS), np.random.default_rng(1).normal(size=(ROWS, 4)) * (10.0, 10.0, 20.0, 0.5)
    state, memory, _, _ = step_by_numba(simulation, x, hand)
    next_state, next_memory = call(engines.step_function(simulation, True, None, True), *x.of_step(), hand)
    np.testing.assert_allclose(next_state, state, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(next_memory, memory, rtol=1e-13, atol=1e-13)


def test_observation_and_reference_are_those_of_the_environment() -> None:
    simulation = SIMULATIONS["paper"]
    x = Inputs(simulation, ROWS)
    state, _, observation, outcome = step_by_numba(simulation, x)
    (point,) = call(engines.reference_function(), x.reference, np.full((ROWS, 1), simulation.period))
    observed, error = call(engines.observation_function(), state, x.parameters, point)
    np.testing.assert_allclose(observed, observation, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(error.T, outcome[places.TRACKING_ERROR], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", SIMULATIONS)
def test_the_jacobian_agrees_with_finite_differences(name: str) -> None:
    simulation = SIMULATIONS[name]
    function, x = engines.step_function(simulation, moves_air=True), Inputs(simulation, 1)
    names, results, start = function.name_in(), function.name_out(), [array[0] for array in x.of_step()]
    derivatives = [f"jac:{result}:{name}" for result in results for name in names]
    exact = [np.array(block) for block in function.factory("jacobian", names, derivatives).call(start)]
    jacobian = np.vstack([np.hstack(exact[: len(names)]), np.hstack(exact[len(names) :])])
    point, ends = np.concatenate(start), np.cumsum([len(array) for array in start])[:-1]
    changes = 1e-4 * np.diag(np.maximum(1e-2, np.abs(point)))

    def after(factor: float) -> Floats:
        """The results after a change of each number, one column for each."""
        return np.hstack(call(function, *np.split(point + factor * changes, ends, axis=1))).T

    difference = (8.0 * (after(1.0) - after(-1.0)) - (after(2.0) - after(-2.0))) / (12.0 * np.diag(changes))
    scale = np.maximum(1.0, np.abs(difference).max(0))  # of each column
    np.testing.assert_allclose(jacobian / scale, difference / scale, atol=1e-8)


def test_the_drag_at_rest_has_derivatives() -> None:
    simulation = SIMULATIONS["wrench"]
    function, state = engines.step_function(simulation, moves_air=True), np.zeros((1, 18))
    state[0, 14] = 1.0
    arguments = state, engines.initial_memory(simulation, state), np.zeros((1, 4)), np.zeros((1, 12))
    jacobian = function.factory("jacobian", function.name_in(), ["jac:next_state:state"])
    (found,) = jacobian.call([*(array[0] for array in arguments), simulation.parameters.as_array()])
    assert np.isfinite(np.array(found)).all()
