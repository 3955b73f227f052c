"""The control step of a policy as functions of CasADi, from the equations that numba compiles.

``policy.c`` calls them in this order. Their arguments have these names:

| argument  | size | content                                                                                     |
|-----------|------|---------------------------------------------------------------------------------------------|
| observed  | 27   | the observation of the environment without rates                                            |
| memory    | m    | an estimate (`estimation.estimate`, also that of `estimation.deso`), or an observation       |
| later     | e    | the estimate at the time when the action acts                                               |
| extra     | k    | memory of the control law, then of the hybrid                                               |
| seen      | n    | inputs of the network                                                                       |
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.controllers import adrc
from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.controllers.lqg import Lqg
from quadpend_baselines.controllers.lqr import Lqr
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation import deso, kalman
from quadpend_baselines.estimation import prediction as predicting
from quadpend_baselines.estimation.estimate import (
    DISTURBANCE,
    INNOVATION,
    LOOP,
    MASS_RATIO,
    REFERENCE,
    RIGID_PART,
    Estimate,
    is_bounded,
)
from quadpend_baselines.estimation.loop import compensate
from quadpend_baselines.estimation.measurement import measure, observation_of
from quadpend_baselines.hybrid.hybrids import _MAGNIFICATION, EstimateOnly
from quadpend_baselines.hybrid.innovations import FILTERED_SIZE
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, mean_squares
from quadpend_baselines.modelling.quantities import store_vectors
from quadpend_gym import Simulation
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.physics.attitude import Quaternion, euler_from_rotation, normalised, rotation_matrix
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, FORCE, STATE_SIZE, THRUST
from quadpend_gym.physics.vectors import Four
from quadpend_gym.tasks.observation import (
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_COLUMNS,
    OUTPUT_FEEDBACK_SIZE,
    REFERENCE_START,
)
from quadpend_train.common.lifted_inputs import deviations_of, innovations_of, lifted_plant, nominal_estimate
from quadpend_train.policies.mlp_policy import MlpPolicy

_HIGHEST = 1e30  # in place of infinity in the limits of observers


class Program(NamedTuple):
    """A control step as functions of CasADi."""

    functions: dict[str, Any]
    parts: list[str]  # the functions of the control period, and of the time until the action acts
    memory: int
    extra: int
    estimate: int  # 0: the policy predicts no vehicle
    checked: int  # numbers at the beginning of the memory that must stay below `limit`
    limit: float


def _function(name: str, make: Callable[..., dict[str, Any]], **sizes: int) -> Any:
    """Return a function of CasADi with arguments of these sizes."""
    symbols = {argument: ca.SX.sym(argument, size) for argument, size in sizes.items()}
    results = make(**symbols)
    values = ca.cse([ca.densify(ca.SX(value)) for value in results.values()])
    return ca.Function(name, list(symbols.values()), values, list(symbols), list(results))


def _row(value: Any) -> Any:
    """Return a vector as an array of one row."""
    return columns(value).T


def _observe(position: Any, quaternion: Any, direction: Any, derivatives: Any, yaw: Any, length: float) -> Any:
    """Return the observation without rates, shape (27,)."""
    rotation = lift(rotation_matrix)(lift(normalised)(Quaternion(*ca.vertsplit(quaternion))))
    euler = lift(euler_from_rotation)(rotation, yaw[0])  # within half a turn of the reference
    error = position - derivatives[:3] + ca.vertcat(length * direction[:2], 0.0)
    attitude = ca.vertcat(euler.x, euler.y, euler.z - yaw[0])
    observed = ca.vertcat(error, direction, attitude, derivatives[6:], yaw)
    return observed / OBSERVATION_SCALE[OUTPUT_FEEDBACK_COLUMNS]


def program(policy: Any, simulation: Simulation) -> Program:
    """Return the control step of an adapted policy.

    Raises:
        ValueError: The policy has a part that is not read.
    """
    length = simulation.parameters.rod_length
    observe = _function(
        "observe",
        lambda **given: {"observed": _observe(**given, length=length)},
        **{"position": 3, "quaternion": 4, "direction": 3, "derivatives": 21, "yaw": 3},
    )
    hybrid = policy.hybrid if isinstance(policy, MlpPolicy) else None
    if isinstance(policy, ADRC):
        found = _adrc(policy)
    elif isinstance(policy, OutputFeedback):
        found = _with_law(_observer(policy), policy)
    elif hybrid is None:
        found = _differences(simulation)
    elif isinstance(hybrid.controller, OutputFeedback):
        found = _with_hybrid(_observer(hybrid.controller), hybrid)
    else:
        raise ValueError("networks that read the observers of ADRC are not written as C")
    return found._replace(functions={"observe": observe, **found.functions})


def _parts(prediction: Any, size: int, advances: Any = predicting.advance) -> tuple[dict[str, Any], list[str]]:
    """Return the functions that advance an estimate of a length, and their names for each part of the loop."""
    packed, packed_rigid = prediction.numbers
    loop, rigid = lift(predicting.unpack_loop)(packed), None if packed_rigid is None else unpack_rigid(packed_rigid)
    found: dict[tuple[float, ...], str] = {}
    functions, names = {}, []
    for k, part in enumerate(prediction.parts):
        key = (*part, *prediction.actuators[k].ravel())
        if key not in found:
            found[key] = f"advance_{len(found)}"

            def advance(state: Any, chosen: Any, k: int = k) -> dict[str, Any]:
                memory, buffer = columns(state), np.empty((predicting.BUFFER_SIZE, 1), object)
                lift(advances)(memory, 0, Four(*ca.vertsplit(chosen)), k, loop, rigid, buffer)
                return {"following": vector(memory)}

            functions[found[key]] = _function(found[key], advance, state=size, chosen=ACTION_SIZE)
        names.append(found[key])
    return functions, names


def _arrive(memory: Any, loop: Any) -> None:
    """Finish an estimate that was advanced by all parts."""
    if loop.parts.shape[0] > 1:
        lift(predicting.arrive)(memory, 0, loop)


def _observer(base: OutputFeedback) -> Program:
    """Return the Kalman observer, without a control law."""
    found, size = base.estimator, base.estimator.size
    share, packed, packed_rigid = found.numbers
    used = found.tables[0].any(axis=0)
    loop, rigid = lift(predicting.unpack_loop)(packed), None if packed_rigid is None else unpack_rigid(packed_rigid)
    pendulum = loop.plant.pendulum
    functions, names = _parts(found.prediction, size)

    def measured(observed: Any) -> tuple[Any, bool, Any]:
        state, reference = lift(measure)(columns(observed), 0, False, pendulum.vehicle.rod_length)
        return state, False, reference

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(kalman.begin)(memory, 0, *measured(observed), pendulum, rigid)
        return {"memory": vector(memory)}

    def correct(memory: Any, observed: Any, gain: Any) -> dict[str, Any]:
        given, after, buffer = np.zeros(used.shape, object), columns(memory), np.empty((24, 1), object)
        given[used] = ca.vertsplit(gain)
        lift(kalman.correct)(after, 0, *measured(observed), given, share, pendulum.vehicle, rigid, buffer)
        return {"next": vector(after)}

    def miss(memory: Any, observed: Any) -> dict[str, Any]:
        after = columns(memory)
        lift(store_vectors)(after, REFERENCE, 0, measured(observed)[2])
        after[INNOVATION:RIGID_PART] = 0.0  # nothing was measured
        return {"next": vector(after)}

    functions["begin"] = _function("begin", begin, observed=OUTPUT_FEEDBACK_SIZE)
    functions["miss"] = _function("miss", miss, memory=size, observed=OUTPUT_FEEDBACK_SIZE)
    sizes = {"memory": size, "observed": OUTPUT_FEEDBACK_SIZE, "gain": int(used.sum())}
    functions["correct"] = _function("correct", correct, **sizes)
    return Program(functions, names, size, 0, size, STATE_SIZE, kalman.MAX_ESTIMATE)


def _control(base: OutputFeedback, later: Any, law_memory: Any) -> tuple[Any, Any]:
    """Return action and memory of the law as vectors, as `OutputFeedback.control` does."""
    prediction, law, after = base.estimator.prediction, base._law, columns(later)
    _arrive(after, lift(predicting.unpack_loop)(prediction.numbers[0]))
    nominal = nominal_estimate(after, bool(base.gains.estimator.mass_time))
    ratio, plant = after[MASS_RATIO, 0], lifted_plant(base.simulation)
    memory = _row(law_memory) if isinstance(law, Lqr) else ()
    command, memory = lift(type(law).command, {plant_of: lifted_plant})(law, nominal, memory)
    if isinstance(law, Lqg):
        command[0, THRUST] = ratio * (1.0 + command[0, THRUST]) - 1.0
        wanted = columns([ca.fmin(ca.fmax(a, -1.0), 1.0) for a in command[0]])
    else:
        command[0, THRUST] *= ratio
        wanted = plant.actions_for(command, after[RIGID_PART:LOOP].T).T
    lift(compensate)(wanted, prediction.loop.steps, prediction.actuators[0], after, LOOP, 0)
    return vector(wanted), vector(memory) if isinstance(law, Lqr) else law_memory


def _law_size(base: OutputFeedback) -> int:
    return 3 if isinstance(base._law, Lqr) else 0


def _with_law(observer: Program, base: OutputFeedback) -> Program:
    extra = max(_law_size(base), 1)

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        action, after = _control(base, later, extra)
        return {"action": action, "next_extra": after}

    sizes = {"memory": observer.memory, "later": observer.estimate, "extra": extra, "output": ACTION_SIZE}
    functions = {**observer.functions, "law": _function("law", law, **sizes)}
    return observer._replace(functions=functions, extra=extra)


def _with_hybrid(observer: Program, hybrid: Any) -> Program:
    base: OutputFeedback = hybrid.controller
    law_size, loop = _law_size(base), lift(predicting.unpack_loop)(base.estimator.prediction.numbers[0])
    length, hover = base.simulation.parameters.rod_length, base.simulation.parameters.hover_thrust
    alone = isinstance(hybrid, EstimateOnly)
    parts: Any = law_size, ACTION_SIZE
    if alone:
        situation, filtered_size = (SITUATION_SIZE, DISTURBANCE_SIZE), FILTERED_SIZE * hybrid.innovations
        parts = law_size, *(size * hybrid.situation for size in situation), 1, filtered_size
    starts = np.cumsum([0, *parts]).tolist()

    def disturbance_of(memory: Any) -> Any:
        disturbance = _row(memory)[:, DISTURBANCE:REFERENCE].copy()
        disturbance[0, FORCE + 2] -= (memory[MASS_RATIO] - 1.0) * hover
        return disturbance

    def estimate_only(memory: Any, later: Any, extra: Any) -> dict[str, Any]:
        after, disturbance = columns(later), disturbance_of(memory)
        _arrive(after, loop)
        if hybrid.deviations:
            seen = [deviations_of(base._law, after, bool(base.gains.estimator.mass_time))]
        else:
            seen = [vector(lift(observation_of)(Estimate(after.T), length)), vector(disturbance)]
        law_memory, squares, last, steps, filtered = ca.vertsplit(extra, starts)
        if hybrid.situation:
            steps = steps + 1.0
            change = _row(ca.if_else(steps > 1.0, vector(disturbance) - last, 0.0))
            innovation = _row(memory)[:, INNOVATION:RIGID_PART]
            share = ca.fmax(1.0 / steps, base.simulation.period / 1.0)
            squares += share * (vector(mean_squares(innovation, disturbance, change)) - squares)
            last = vector(disturbance)
            seen.append(ca.sqrt(squares))
        if hybrid.innovations:
            seen.append(innovations_of(columns(memory), filtered, base.simulation.period))
            filtered = seen[-1][-FILTERED_SIZE:]
        return {"seen": ca.vertcat(*seen), "next_extra": ca.vertcat(law_memory, squares, last, steps, filtered)}

    def correction(memory: Any, later: Any, extra: Any) -> dict[str, Any]:
        law_memory, _ = ca.vertsplit(extra, starts)
        estimated = vector(lift(observation_of)(Estimate(_row(memory)), length))
        action, law_memory = _control(base, later, law_memory)
        near = float(_MAGNIFICATION)
        parts = near * estimated[:REFERENCE_START], estimated[REFERENCE_START:], vector(disturbance_of(memory))
        return {"seen": ca.vertcat(*parts, near * action), "next_extra": ca.vertcat(law_memory, action)}

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        action = output if alone else extra[law_size:] + hybrid.action_scale * output
        return {"action": action, "next_extra": extra}

    inputs = estimate_only if alone else correction
    sizes = {"memory": observer.memory, "later": observer.estimate, "extra": starts[-1]}
    functions = {
        **observer.functions,
        "inputs": _function("inputs", inputs, **sizes),
        "law": _function("law", law, **sizes, output=ACTION_SIZE),
    }
    return observer._replace(functions=functions, extra=starts[-1])


def _differences(simulation: Simulation) -> Program:
    """Return the control step of a network whose rates are finite differences, see `policies.finite_differences`."""
    size = 9 + OBSERVATION_SIZE

    def memory_of(observed: Any, last: Any) -> Any:
        outputs = observed[:9] * OBSERVATION_SCALE[OUTPUT_FEEDBACK_COLUMNS[:9]]
        rates = (outputs - (outputs if last is None else last)) / simulation.period
        rates[8] += observed[-2] * OBSERVATION_SCALE[-2]
        full = ca.SX.zeros(OBSERVATION_SIZE)
        full[OUTPUT_FEEDBACK_COLUMNS.tolist()] = observed
        hidden = np.setdiff1d(np.arange(REFERENCE_START), OUTPUT_FEEDBACK_COLUMNS)
        full[hidden.tolist()] = rates / OBSERVATION_SCALE[hidden]
        return ca.vertcat(outputs, full)

    def begin(observed: Any) -> dict[str, Any]:
        return {"memory": memory_of(observed, None)}

    def correct(memory: Any, observed: Any) -> dict[str, Any]:
        return {"next": memory_of(observed, memory[:9])}

    def inputs(memory: Any, later: Any, extra: Any) -> dict[str, Any]:
        return {"seen": memory[9:], "next_extra": extra}

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        return {"action": output, "next_extra": extra}

    seen = {"memory": size, "later": size, "extra": 1}
    functions = {
        "begin": _function("begin", begin, observed=OUTPUT_FEEDBACK_SIZE),
        "correct": _function("correct", correct, memory=size, observed=OUTPUT_FEEDBACK_SIZE),
        "inputs": _function("inputs", inputs, **seen),
        "law": _function("law", law, **seen, output=ACTION_SIZE),
    }
    return Program(functions, [], size, 1, 0, 0, 1.0)


def _adrc(policy: ADRC) -> Program:
    """Return the control step of ADRC."""
    found, law, size = policy.bank, policy.law, policy.bank.size
    bank, _, packed, packed_rigid = found.numbers
    bank, mismatch, plant = np.minimum(bank, _HIGHEST), found.bank.mismatch, lifted_plant(policy.simulation)
    loop, rigid = lift(predicting.unpack_loop)(packed), None if packed_rigid is None else unpack_rigid(packed_rigid)
    model, prediction = loop.plant.pendulum, found.prediction

    def measured(observed: Any) -> tuple[Any, bool, Any]:
        state, reference = lift(measure)(columns(observed), 0, False, model.vehicle.rod_length)
        return state, False, reference

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(deso.begin)(memory, 0, *measured(observed), mismatch, model, rigid)
        return {"memory": vector(memory)}

    def release(memory: Any) -> dict[str, Any]:
        released = columns(memory)
        released[DISTURBANCE:MASS_RATIO] = 0.0
        return {"plant": vector(released)}

    def correct(memory: Any, plant: Any, observed: Any) -> dict[str, Any]:
        after, kernel = columns(plant), lift(deso.correct, {is_bounded: lambda *_: True})
        kernel(after, 0, columns(memory), *measured(observed), bank, found.bank, 0, model, rigid)
        return {"next": vector(after)}

    def act(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        after = columns(later)
        _arrive(after, loop)
        if loop.parts.shape[0] > 1:
            lift(deso.shift)(columns(memory), after, 0, model, rigid)
        command = _row(ca.vertcat(*lift(adrc.command_of)(after.T, 0, law.numbers, model, rigid)))
        wanted = plant.actions_for(command, after[RIGID_PART:LOOP].T).T
        lift(compensate)(wanted, prediction.loop.steps, prediction.actuators[0], after, LOOP, 0)
        return {"action": vector(wanted), "next_extra": extra}

    functions, names = _parts(prediction, size, deso.advance_known)
    functions["begin"] = _function("begin", begin, observed=OUTPUT_FEEDBACK_SIZE)
    functions["release"] = _function("release", release, memory=size)
    functions["correct"] = _function("correct", correct, memory=size, plant=size, observed=OUTPUT_FEEDBACK_SIZE)
    functions["law"] = _function("law", act, memory=size, later=size, extra=1, output=ACTION_SIZE)
    return Program(functions, names, size, 1, size, 0, 1.0)
