"""The control step of a policy as functions of CasADi, from the equations that numba compiles.

``policy.c`` calls them in this order, with the arguments that `common.lifted` names; ``extra`` has the memories of the
parts of the inputs, that of the control law, and the action of a base controller that acts before the network.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.controllers.output_feedback import OutputFeedback, actions_of, command_of
from quadpend_baselines.estimation import deso, kalman
from quadpend_baselines.estimation.deso import DesoBank
from quadpend_baselines.estimation.estimate import (
    DISTURBANCE,
    INNOVATION,
    MASS_RATIO,
    RIGID_PART,
    Estimate,
    is_bounded,
    store_measured_reference,
)
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.hybrid import EstimateOnly, ResidualAction
from quadpend_baselines.hybrid.parts import InputPart, observed_part
from quadpend_gym import Simulation
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.physics.attitude import Quaternion, euler_from_rotation, normalised, rotation_matrix
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.tasks.observation import (
    OBSERVATION_SCALE,
    OUTPUT_FEEDBACK,
    OUTPUT_FEEDBACK_COLUMNS,
    OUTPUT_FEEDBACK_SIZE,
)
from quadpend_train.common.lifted import (
    advances,
    arrived,
    correction,
    function,
    lifted_plant,
    measurement,
    numbers_of,
    row,
    seen_by,
)
from quadpend_train.policies.mlp_policy import MlpPolicy

_HIGHEST = 1e30  # in place of infinity in the limits of observers
_PLANT = {plant_of: lifted_plant}


class Program(NamedTuple):
    """A control step as functions of CasADi."""

    functions: dict[str, Any]
    parts: list[str]  # the functions of the control period, and of the time until the action acts
    memory: int
    extra: int
    estimate: int  # 0: the policy predicts no vehicle
    checked: int  # numbers at the beginning of the memory that must stay below `limit`
    limit: float


def _observe(position: Any, quaternion: Any, direction: Any, derivatives: Any, yaw: Any, length: float) -> Any:
    """Return the observation without rates, shape (27,)."""
    rotation = lift(rotation_matrix)(lift(normalised)(Quaternion(*ca.vertsplit(quaternion))))
    euler = lift(euler_from_rotation)(rotation, yaw[0])  # within half a turn of the reference
    error = position - derivatives[:3] + ca.vertcat(length * direction[:2], 0.0)
    attitude = ca.vertcat(euler.x, euler.y, euler.z - yaw[0])
    observed = ca.vertcat(error, direction, attitude, derivatives[6:], yaw)
    return observed / OBSERVATION_SCALE[OUTPUT_FEEDBACK_COLUMNS]


class _Base(NamedTuple):
    """A base controller, as a network needs it."""

    observer: Program
    arrived: Callable[[Any, Any], Any]  # (memory, later) → the estimate at the time when the action acts, one row
    control: Callable[[Any, Any], Any]  # (this estimate, memory of the law) → its action, and the memory after it
    law_size: int  # of the memory of the law


def program(policy: Any, simulation: Simulation, part: InputPart) -> Program:
    """Return the control step of an adapted policy; `part` makes the observation that it reads."""
    length = simulation.parameters.rod_length
    observe = function(
        "observe",
        lambda **given: {"observed": _observe(**given, length=length)},
        **{"position": 3, "quaternion": 4, "direction": 3, "derivatives": 21, "yaw": 3},
    )
    hybrid = policy.hybrid if isinstance(policy, MlpPolicy) else None
    base = _base(policy if hybrid is None else hybrid.controller)
    if not isinstance(policy, MlpPolicy):
        found = _with_law(base)
    elif hybrid is None:
        found = _with_network(base, part, (observed_part(range(part.size)),), EstimateOnly)
    else:
        found = _with_network(base, part, hybrid.parts(part.size), type(hybrid), hybrid)
    return found._replace(functions={"observe": observe, **found.functions})


def _base(controller: Any) -> _Base:
    """Return a base controller, or for a network alone none."""
    observer = getattr(controller, "observer", "none")
    if observer == "deso":
        return _with_control(_deso(controller.estimator), controller, lift(deso.shift))
    if observer == "kalman":
        return _with_control(_kalman(controller.estimator), controller, lambda *_: None)
    size = OUTPUT_FEEDBACK_SIZE  # the memory is the observation
    functions = {
        "begin": function("begin", lambda observed: {"memory": observed}, observed=size),
        "correct": function("correct", lambda memory, observed: {"next": observed}, memory=size, observed=size),
    }
    observer = Program(functions, [], size, 0, 0, 0, 1.0)
    return _Base(observer, lambda memory, later: row(later), lambda later, law: (ca.SX(ACTION_SIZE, 1), law), 0)


def _kalman(found: Estimator) -> Program:
    """Return the Kalman observer."""
    size, (loop, rigid) = found.size, numbers_of(found.prediction)
    pendulum = loop.plant.pendulum
    vehicle = pendulum.vehicle
    functions, names = advances(found.prediction, size)

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(kalman.begin)(memory, 0, measurement(observed, OUTPUT_FEEDBACK, vehicle), False, pendulum, rigid)
        return {"memory": vector(memory)}

    def miss(memory: Any, observed: Any) -> dict[str, Any]:
        after = columns(memory)
        lift(store_measured_reference)(after, 0, measurement(observed, OUTPUT_FEEDBACK, vehicle))
        after[INNOVATION:RIGID_PART] = 0.0  # nothing was measured
        return {"next": vector(after)}

    functions["begin"] = function("begin", begin, observed=OUTPUT_FEEDBACK_SIZE)
    functions["miss"] = function("miss", miss, memory=size, observed=OUTPUT_FEEDBACK_SIZE)
    functions["correct"] = correction(found, OUTPUT_FEEDBACK)
    return Program(functions, names, size, 0, size, STATE_SIZE, kalman.MAX_ESTIMATE)


def _deso(found: DesoBank) -> Program:
    """Return the observers of ADRC."""
    size, (loop, rigid) = found.size, numbers_of(found.prediction)
    model, bank = loop.plant.pendulum, np.minimum(found.numbers[0], _HIGHEST)
    vehicle = model.vehicle
    functions, names = advances(found.prediction, size, deso.advance_known)

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(deso.begin)(
            memory, 0, measurement(observed, OUTPUT_FEEDBACK, vehicle), False, found.bank.mismatch, model, rigid
        )
        return {"memory": vector(memory)}

    def release(memory: Any) -> dict[str, Any]:
        released = columns(memory)
        released[DISTURBANCE:MASS_RATIO] = 0.0
        return {"plant": vector(released)}

    def correct(memory: Any, plant: Any, observed: Any) -> dict[str, Any]:
        after, kernel = columns(plant), lift(deso.correct, {is_bounded: lambda *_: True})
        seen = measurement(observed, OUTPUT_FEEDBACK, vehicle)
        kernel(after, 0, columns(memory), seen, False, (0.0, 0.0, 0), bank, found.bank, model, rigid)
        return {"next": vector(after)}

    functions["begin"] = function("begin", begin, observed=OUTPUT_FEEDBACK_SIZE)
    functions["release"] = function("release", release, memory=size)
    functions["correct"] = function("correct", correct, memory=size, plant=size, observed=OUTPUT_FEEDBACK_SIZE)
    return Program(functions, names, size, 0, size, 0, 1.0)


def _with_control(observer: Program, base: OutputFeedback, shift: Any) -> _Base:
    """Return an observer with the control law on its estimate, which `shift` changes while it is carried forward."""
    prediction, law_size = base.estimator.prediction, np.size(base._law.initial_memory(1))
    loop, rigid = numbers_of(prediction)

    def arrive(memory: Any, later: Any) -> Any:
        after = arrived(later, prediction)
        if loop.parts.shape[0] > 1:
            shift(columns(memory), after.T, 0, loop.plant.pendulum, rigid)
        return after

    def command(law: Any, estimate: Estimate, memory: Any) -> Any:
        return lift(type(law).command, _PLANT)(law, estimate, memory)

    def control(later: Any, law_memory: Any) -> tuple[Any, Any]:
        act, last = lift(actions_of, {**_PLANT, command_of: command}), row(law_memory) if law_size else ()
        action, after = act(base._law, prediction, Estimate(later), last)
        return vector(action), vector(after) if law_size else law_memory

    return _Base(observer, arrive, control, law_size)


def _with_law(base: _Base) -> Program:
    """Return the step of the base controller alone."""
    extra_size = max(base.law_size, 1)

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        action, after = base.control(base.arrived(memory, later), extra)
        return {"action": action, "next_extra": after}

    sizes = {"memory": base.observer.memory, "later": base.observer.estimate, "extra": extra_size}
    functions = {**base.observer.functions, "law": function("law", law, **sizes, output=ACTION_SIZE)}
    return base.observer._replace(functions=functions, extra=extra_size)


def _with_network(
    base: _Base, reads: InputPart, parts: tuple[InputPart, ...], kind: Any, hybrid: Any = None
) -> Program:
    """Return the step of a network with these inputs, in a hybrid of a kind."""
    acts = kind is ResidualAction  # the base controller, before the network
    own_size = sum(part.memory_size for part in parts)
    starts = np.cumsum([0, reads.memory_size, own_size, base.law_size * acts, ACTION_SIZE]).tolist()

    def inputs(observed: Any, memory: Any, later: Any, action: Any, extra: Any) -> dict[str, Any]:
        read, own, law_memory, base_action = ca.vertsplit(extra, starts)
        after = base.arrived(memory, later)
        if acts:
            base_action, law_memory = base.control(after, law_memory)
        given = action, base_action, memory, after
        chosen, read = seen_by((reads,), observed, *given, read)
        seen, own = seen_by(parts, chosen, *given, own)
        return {"seen": seen, "next_extra": ca.vertcat(read, own, law_memory, base_action)}

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        applied = lift(kind._applied)(hybrid, row(output), row(extra[starts[3] :]))
        return {"action": vector(applied), "next_extra": extra}

    sizes = {"memory": base.observer.memory, "later": base.observer.estimate or base.observer.memory}
    functions = {
        **base.observer.functions,
        "inputs": function(
            "inputs", inputs, observed=OUTPUT_FEEDBACK_SIZE, **sizes, action=ACTION_SIZE, extra=starts[-1]
        ),
        "law": function("law", law, **sizes, extra=starts[-1], output=ACTION_SIZE),
    }
    return base.observer._replace(functions=functions, extra=starts[-1])
