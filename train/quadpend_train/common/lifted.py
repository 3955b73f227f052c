"""Observer and inputs of a policy as functions of CasADi, from the equations that numba compiles.

Gradients (`training.observed`) and C (`export.program`) are made of them. Their arguments have these names:

| argument  | size | content                                                                                     |
|-----------|------|---------------------------------------------------------------------------------------------|
| observed  | n    | the observation of the environment: `FULL`, `LAB` or `OUTPUT_FEEDBACK`                      |
| memory    | m    | an estimate (`estimation.estimate`, also that of `estimation.deso`), or an observation       |
| later     | m    | the estimate before it is finished for the time when the action acts                        |
| action    | 4    | the last applied action                                                                     |
| extra     | k    | memories of the parts of the inputs (`hybrid.parts`)                                        |
| seen      | n    | inputs of the network                                                                       |
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from quadpend_baselines.estimation import kalman
from quadpend_baselines.estimation.estimate import LOOP
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.estimation.measurement import errors_of_estimate, measure_errors, measure_in_world
from quadpend_baselines.estimation.prediction import (
    BUFFER_SIZE,
    Prediction,
    add_reference_drag,
    advance,
    arrive,
    unpack_loop,
)
from quadpend_baselines.hybrid.parts import InputPart, Seen, read_inputs
from quadpend_gym import Simulation
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.engines.lifting import rows
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.physics.vectors import Four
from quadpend_gym.tasks.observation import FULL, LAB, OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS, ObservationLayout
from quadpend_gym.vehicles import Parameters


def function(name: str, make: Callable[..., dict[str, Any]], **sizes: int) -> Any:
    """Return a function of CasADi with arguments of these sizes."""
    symbols = {argument: ca.SX.sym(argument, size) for argument, size in sizes.items()}
    results = make(**symbols)
    values = ca.cse([ca.densify(ca.SX(value)) for value in results.values()])
    return ca.Function(name, list(symbols.values()), values, list(symbols), list(results))


def row(value: Any) -> Any:
    """Return a vector as an array of one row."""
    return rows(ca.vertsplit(value) if value.numel() else ())


def lifted_plant(simulation: Simulation) -> Any:
    """Return the plant of a simulation for functions that CasADi reads."""
    plant: Any = plant_of(simulation)
    return SimpleNamespace(actions_for=partial(lift(type(plant).actions_for), plant))


def numbers_of(prediction: Prediction) -> tuple[Any, Any]:
    """Return the vehicle and its loop, and the settings of a rigid vehicle."""
    packed, packed_rigid = prediction.numbers
    return lift(unpack_loop)(packed), None if packed_rigid is None else unpack_rigid(packed_rigid)


def advances(prediction: Prediction, size: int, kernel: Any = advance) -> tuple[dict[str, Any], list[str]]:
    """Return the functions that advance an estimate of a length, and their names for each part of the loop."""
    loop, rigid = numbers_of(prediction)
    found: dict[tuple[float, ...], str] = {}
    functions, names = {}, []
    for k, part in enumerate(prediction.parts):
        key = (*part, *prediction.lags[k].ravel())
        if key not in found:
            found[key] = f"advance_{len(found)}"

            def step(memory: Any, action: Any, k: int = k) -> dict[str, Any]:
                state, buffer = columns(memory), np.empty((BUFFER_SIZE, 1), object)
                lift(kernel)(state, 0, Four(*ca.vertsplit(action)), k, loop, rigid, buffer)
                return {"next": vector(state)}

            functions[found[key]] = function(found[key], step, memory=size, action=ACTION_SIZE)
        names.append(found[key])
    return functions, names


def arrived(later: Any, prediction: Prediction) -> Any:
    """Return an estimate, one row, at the time when the action acts: it was advanced by all parts of the loop."""
    after, loop = row(later), numbers_of(prediction)[0]
    if loop.parts.shape[0] > 1:
        lift(arrive)(after.T, 0, loop)
    return after


def with_reference_drag(estimate: Any, prediction: Prediction) -> Any:
    """Return an estimate, one row, with the forces that networks get."""
    after = estimate.copy()
    lift(add_reference_drag)(after.T, 0, *numbers_of(prediction))
    return after


def measurement(observed: Any, layout: ObservationLayout, vehicle: Parameters) -> Any:
    """Return the measurement of an observation as lanes."""
    seen, given, length = np.zeros((LOOP, 1), object), columns(observed), vehicle.rod_length
    if layout == LAB:
        lift(measure_in_world)(given, 0, length, vehicle.bob_mass, seen)
    else:
        lift(measure_errors)(given, 0, layout == FULL, length, seen)
    return seen


def errors(observed: Any, vehicle: Parameters) -> Any:
    """Return the observation `OUTPUT_FEEDBACK` for the observation `LAB` of the believed pole."""
    out = np.empty((1, OBSERVATION_SIZE), object)
    lift(errors_of_estimate)(measurement(observed, LAB, vehicle).T, 0, vehicle.rod_length, out)
    return ca.vertcat(*out[0, OUTPUT_FEEDBACK_COLUMNS])


def correction(estimator: Estimator, layout: ObservationLayout) -> Any:
    """Return the correction of an estimate, (memory, observed, gain) → next; gains that are always zero are left out.

    The estimate was advanced over a period.
    """
    used: Any = estimator.tables[layout == FULL].any(axis=0)
    loop, rigid = numbers_of(estimator.prediction)
    vehicle = loop.plant.pendulum.vehicle

    def correct(memory: Any, observed: Any, gain: Any) -> dict[str, Any]:
        given, after, buffer = np.zeros(used.shape, object), columns(memory), np.empty((len(used), 1), object)
        given[used] = ca.vertsplit(gain)
        seen, share = measurement(observed, layout, vehicle), estimator.numbers[0]
        known = layout == FULL, float(layout == LAB), estimator.simulation.period
        lift(kalman.correct)(after, 0, seen, *known, given, share, vehicle, rigid, buffer)
        return {"next": vector(after)}

    sizes = {"memory": estimator.size, "observed": layout.size, "gain": int(used.sum())}
    return function("correct", correct, **sizes)


def seen_by(
    parts: Sequence[InputPart],
    observed: Any,
    action: Any,
    base_action: Any,
    memory: Any,
    later: Any,
    extra: Any,
    replaced: Mapping[Any, Any] | None = None,
) -> tuple[Any, Any]:
    """Return the inputs and the memories of parts as vectors; `later` is an array of one row, see `arrived`.

    `replaced` are functions in place of others, see `lift`.
    """
    others = {plant_of: lifted_plant, **(replaced or {})}
    lifted = [part._replace(function=lift(part.function, others)) for part in parts]
    seen = Seen(row(observed), row(action), row(base_action), row(memory), later)
    found, after = read_inputs(lifted, seen, row(extra))
    return vector(found), vector(after)
