"""The control step of a policy as functions of CasADi, from the equations that numba compiles.

``policy.c`` calls them in this order, with the arguments that `common.lifted` names; ``extra`` has the memories of the
parts of the inputs, that of the control law, and the action of a base controller that acts before the network.
"""

from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.controllers.output_feedback import OutputFeedback, actions_of
from quadpend_baselines.estimation import deso, kalman, samples
from quadpend_baselines.estimation.deso import DesoBank
from quadpend_baselines.estimation.estimate import (
    DISTURBANCE,
    MASS_RATIO,
    Estimate,
    is_bounded,
)
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.hybrid import EstimateOnly, ResidualAction, scheduled_gain
from quadpend_baselines.hybrid.parts import InputPart, observed_part
from quadpend_gym import Simulation
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import Four
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK_SIZE
from quadpend_gym.vehicles import Parameters
from quadpend_train.common.lifted import (
    advances,
    arrived,
    correction,
    errors,
    function,
    lifted_plant,
    measurement,
    numbers_of,
    row,
    seen_by,
    with_reference_drag,
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


class _Base(NamedTuple):
    """A base controller, as a network needs it."""

    observer: Program
    seen: Callable[[Any], Any]  # (estimate, one row) → the estimate as a network gets it
    arrived: Callable[[Any, Any], Any]  # (memory, later) → the estimate at the time when the action acts, one row
    control: Callable[[Any, Any], Any]  # (this estimate, memory of the law) → its action, and the memory after it
    law_size: int  # of the memory of the law


def program(policy: Any, simulation: Simulation, read: Sequence[int]) -> Program:
    """Return the control step of an adapted policy, which reads these columns of the observation of errors or `LAB`."""
    hybrid = policy.hybrid if isinstance(policy, MlpPolicy) else None
    reads_lab = hybrid is not None and hybrid.reads == "lab"
    size = LAB.size if reads_lab else OUTPUT_FEEDBACK_SIZE
    base = _base(policy if hybrid is None else hybrid.controller, size)
    if not isinstance(policy, MlpPolicy):
        return _with_law(base)
    if hybrid is None:
        found = _with_network(base, size, read, (observed_part(len(read)),), EstimateOnly)
    else:
        found = _with_network(base, size, read, hybrid.parts(len(read)), type(hybrid), hybrid)
    p = simulation.parameters

    def observe(observed: Any) -> dict[str, Any]:
        return {"read": observed if reads_lab else errors(observed, p)}

    return found._replace(functions={"observe": function("observe", observe, observed=LAB.size), **found.functions})


def _base(controller: Any, size: int) -> _Base:
    """Return a base controller, or for a network alone none; a network observes `size` numbers."""
    observer = getattr(controller, "observer", "none")
    if observer == "deso":
        return _with_control(_deso(controller.estimator), controller, lift(deso.shift))
    if observer == "kalman":
        return _with_control(_kalman(controller.estimator), controller, lambda *_: None)
    functions = {  # the memory is what the network observes
        "begin": function("begin", lambda read: {"memory": read}, read=size),
        "correct": function("correct", lambda memory, read: {"next": read}, memory=size, read=size),
    }
    observer = Program(functions, [], size, 0, 0, 0, 1.0)
    return _Base(
        observer,
        lambda estimate: estimate,
        lambda memory, later: row(later),
        lambda later, law: (ca.SX(ACTION_SIZE, 1), law),
        0,
    )


def _judge(size: int, vehicle: Parameters, period: float, width: float) -> Any:
    """Return the verdict on a sample, (memory, expected, observed) → (next, verdict); see `samples.judge`."""

    def judge(memory: Any, expected: Any, observed: Any) -> dict[str, Any]:
        after, seen = columns(memory), measurement(observed, LAB, vehicle)
        verdict = lift(samples.judge)(after, columns(expected), 0, seen, period, 1.0, width)
        return {"next": vector(after), "verdict": vector(verdict)}

    return function("judge", judge, memory=size, expected=size, observed=LAB.size)


def _kalman(found: Estimator) -> Program:
    """Return the Kalman observer."""
    size, (loop, rigid) = found.size, numbers_of(found.prediction)
    pendulum = loop.plant.pendulum
    vehicle = pendulum.vehicle
    functions, names = advances(found.prediction, size)

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(kalman.begin)(memory, 0, measurement(observed, LAB, vehicle), False, pendulum, rigid)
        return {"memory": vector(memory)}

    def miss(memory: Any, observed: Any) -> dict[str, Any]:
        after = columns(memory)
        lift(kalman.miss)(after, 0, measurement(observed, LAB, vehicle))
        return {"next": vector(after)}

    def begin_anew(memory: Any, observed: Any) -> dict[str, Any]:
        after = columns(memory)
        lift(kalman.begin_anew)(after, 0, measurement(observed, LAB, vehicle), rigid)
        return {"next": vector(after)}

    functions["begin"] = function("begin", begin, observed=LAB.size)
    functions["miss"] = function("miss", miss, memory=size, observed=LAB.size)
    functions["begin_anew"] = function("begin_anew", begin_anew, memory=size, observed=LAB.size)
    functions["judge"] = _judge(size, vehicle, found.simulation.period, 1.0)
    functions["correct"] = correction(found, LAB)
    return Program(functions, names, size, 0, size, STATE_SIZE, kalman.MAX_ESTIMATE)


def _deso(found: DesoBank) -> Program:
    """Return the observers of ADRC."""
    size, (loop, rigid) = found.size, numbers_of(found.prediction)
    model, bank = loop.plant.pendulum, np.minimum(found.numbers[0], _HIGHEST)
    vehicle = model.vehicle
    functions, names = advances(found.prediction, size, deso.advance_known)

    def begin(observed: Any) -> dict[str, Any]:
        memory = np.zeros((size, 1), object)
        lift(deso.begin)(memory, 0, measurement(observed, LAB, vehicle), False, found.bank.mismatch, model, rigid)
        return {"memory": vector(memory)}

    def release(memory: Any) -> dict[str, Any]:
        released = columns(memory)
        released[DISTURBANCE:MASS_RATIO] = 0.0
        return {"plant": vector(released)}

    def correct(memory: Any, plant: Any, observed: Any, verdict: Any) -> dict[str, Any]:
        after, kernel = columns(plant), lift(deso.correct, {is_bounded: lambda *_: True})
        seen = measurement(observed, LAB, vehicle)
        known = ca.fmax(verdict[0], verdict[1]), 1.0, 0
        kernel(after, 0, columns(memory), seen, False, known, bank, found.bank, model, rigid)
        return {"next": vector(after)}

    def begin_anew(memory: Any, observed: Any) -> dict[str, Any]:
        after = columns(memory)
        lift(deso.begin_anew)(after, 0, measurement(observed, LAB, vehicle), found.bank.mismatch, model, rigid)
        return {"next": vector(after)}

    functions["begin"] = function("begin", begin, observed=LAB.size)
    functions["begin_anew"] = function("begin_anew", begin_anew, memory=size, observed=LAB.size)
    functions["release"] = function("release", release, memory=size)
    functions["judge"] = _judge(size, vehicle, found.simulation.period, deso.WIDTH)
    functions["correct"] = function("correct", correct, memory=size, plant=size, observed=LAB.size, verdict=2)
    return Program(functions, names, size, 0, size, 0, 1.0)


def _with_control(observer: Program, base: OutputFeedback, shift: Any) -> _Base:
    """Return an observer with the control law on its estimate, which `shift` changes while it is carried forward."""
    prediction, law_size = base.estimator.prediction, np.size(base._law.initial_memory(1))
    loop, rigid = numbers_of(prediction)
    law: Any = SimpleNamespace(
        command=partial(lift(type(base._law).command, _PLANT), base._law), commands_actions=base._law.commands_actions
    )

    def arrive(memory: Any, later: Any) -> Any:
        after = arrived(later, prediction)
        if loop.parts.shape[0] > 1:
            shift(columns(memory), after.T, 0, loop.plant.pendulum, rigid)
        return after

    def control(later: Any, law_memory: Any) -> tuple[Any, Any]:
        last = row(law_memory) if law_size else ()
        action, after = lift(actions_of, _PLANT)(law, base.simulation, Estimate(later), last)
        return vector(action), vector(after) if law_size else law_memory

    def seen(estimate: Any) -> Any:
        return with_reference_drag(estimate, prediction)

    return _Base(observer, seen, arrive, control, law_size)


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
    base: _Base, size: int, columns_read: Sequence[int], parts: tuple[InputPart, ...], kind: Any, hybrid: Any = None
) -> Program:
    """Return the step of a network with these inputs of `size` numbers, in a hybrid of a kind."""
    acts = kind is ResidualAction  # the base controller, before the network
    own_size = sum(part.memory_size for part in parts)
    starts = np.cumsum([0, own_size, base.law_size * acts, ACTION_SIZE]).tolist()

    substeps: list[Any] = []  # the function, because the code of all its calls would be long

    def substep(x: Any, action: Any, *known: Any) -> None:
        if not substeps:
            state, given = ca.SX.sym("x", len(x)), ca.SX.sym("a", ACTION_SIZE)
            after = np.array(ca.vertsplit(state), object)
            lift(scheduled_gain.substep)(after, Four(*row(given)[0]), *known)
            arguments = [ca.vertcat(state, given)], ca.cse([vector(after)]), ["x"], ["next"]
            substeps.append(ca.Function("substep", *arguments, {"never_inline": True}))
        x[:] = ca.vertsplit(substeps[0](ca.vertcat(*x, *action)))

    def inputs(read: Any, memory: Any, later: Any, action: Any, extra: Any) -> dict[str, Any]:
        own, law_memory, base_action = ca.vertsplit(extra, starts)
        after = base.arrived(memory, later)
        if acts:
            base_action, law_memory = base.control(after, law_memory)
        given = action, base_action, vector(base.seen(row(memory))), base.seen(after)
        seen, own = seen_by(parts, read[columns_read], *given, own, {scheduled_gain.substep: substep})
        if hybrid is not None:
            base_action = vector(hybrid.builds_on(row(seen), row(base_action)))
        return {"seen": seen, "next_extra": ca.vertcat(own, law_memory, base_action)}

    def law(memory: Any, later: Any, extra: Any, output: Any) -> dict[str, Any]:
        applied = lift(kind._applied)(hybrid, row(output), row(extra[starts[2] :]))
        return {"action": vector(applied), "next_extra": extra}

    sizes = {"memory": base.observer.memory, "later": base.observer.estimate or base.observer.memory}
    functions = {
        **base.observer.functions,
        "inputs": function("inputs", inputs, read=size, **sizes, action=ACTION_SIZE, extra=starts[-1]),
        "law": function("law", law, **sizes, extra=starts[-1], output=ACTION_SIZE),
    }
    return base.observer._replace(functions=functions, extra=starts[-1])
