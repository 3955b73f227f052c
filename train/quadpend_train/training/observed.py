"""What a policy observes, as a function of the flight and of the base controller's observer, for gradients.

The environment and its hybrid compute the values. Here CasADi reads the same equations, those of the observation and of
the observer (`quadpend_baselines.estimation`), so that generated C has their slopes. A step of a row is

    (1)  y = x + n,   b ← g(b, a, y),   o = h(b, y)         n: error of the sensors, independent of the policy

with the belief b: the estimate, which the prediction through known delays and lags belongs to, the running mean squares
of the situation, and the filtered innovations; or the memory of the measurements alone. A delay of the sensors is
known: the flight ends with the last states, the oldest first. What other base controllers than those with a Kalman
observer estimate has no slope.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.controllers.lqg import Lqg
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.estimate import (
    AGE,
    DISTURBANCE,
    INNOVATION,
    MASS_RATIO,
    REFERENCE,
    RIGID_PART,
    STATE,
    YAW,
)
from quadpend_baselines.estimation.kalman import Estimator, correct
from quadpend_baselines.estimation.measurement import measure
from quadpend_baselines.estimation.prediction import BUFFER_SIZE, advance, arrive, unpack_loop
from quadpend_baselines.hybrid.hybrids import MemoryOnly
from quadpend_baselines.hybrid.innovations import FILTERED_SIZE
from quadpend_baselines.hybrid.memory import REMEMBERED_SIZE
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, mean_squares, new_share
from quadpend_baselines.modelling.quantities import bob_offset, load_state
from quadpend_gym import engines
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines import columns, lift, vector
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, FORCE, STATE_SIZE
from quadpend_gym.physics.vectors import Four
from quadpend_gym.tasks.observation import (
    ALL,
    FULL,
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK,
    REFERENCE_START,
    ObservationLayout,
)
from quadpend_gym.tasks.references import POINT_SIZE
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE
from quadpend_train.common.lifted_inputs import deviations_of, innovations_of, remembered_of

_LEAST_SQUARE = 1e-8  # bounds the slope of a root mean square of the situation


class Observer(NamedTuple):
    """What the observation of a policy depends on."""

    estimator: Estimator | None  # None: the policy observes the measured state
    layout: ObservationLayout  # the fields of the environment's observation
    situation: bool  # whether the policy observes it
    innovations: bool  # whether it observes filtered innovations
    law: Lqg | None  # the law of the deviations; None: it observes estimates
    size: int
    period: float = 0.0  # of a memory of the measurements, s; 0: the policy observes none

    @classmethod
    def of(cls, hybrid: Any, layout: ObservationLayout, size: int) -> "Observer":
        """Return the observer of a hybrid; None: there is no hybrid."""
        if isinstance(hybrid, MemoryOnly):
            return cls(None, OUTPUT_FEEDBACK, False, False, None, size, hybrid.period)
        base = None if hybrid is None else hybrid.controller
        estimator = base.estimator if isinstance(base, OutputFeedback) else None
        if estimator is None:
            return cls(None, layout, False, False, None, size)
        law = hybrid.controller._law if hybrid.deviations else None
        return cls(estimator, layout, hybrid.situation, hybrid.innovations, law, size)

    @property
    def has_rates(self) -> bool:
        """Whether the environment's observation has velocities."""
        return self.layout == FULL

    def values(self, memory: Any) -> tuple[Floats, Floats]:
        """Return the beliefs in the memory of a hybrid, and ε and the gains of the next step, both with n rows."""
        if self.estimator is None:
            none = np.zeros((len(memory.base_action), 0))
            return (memory.filtered, none) if self.period else (none, none)
        estimate, situation, gains = memory.controller.estimate.array, memory.situation, _gains(self)
        sensing = gains.values[np.minimum(estimate[:, AGE].astype(np.int64), len(gains.values) - 1)]
        beliefs = [memory.filtered, estimate] if self.innovations else [estimate]
        if self.situation:
            beliefs = [situation.mean_square, situation.disturbance, *beliefs]
            share = new_share(situation.steps + 1.0, self.estimator.simulation.period)
            sensing = np.column_stack([share, sensing])
        return np.hstack(beliefs), sensing

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Sizes of the parts of a belief: mean squares, last disturbance, filtered innovations and estimate."""
        situation = SITUATION_SIZE * self.situation, DISTURBANCE_SIZE * self.situation
        size = 0 if self.estimator is None else self.estimator.size
        return *situation, FILTERED_SIZE * self.innovations, size


class _Gains(NamedTuple):
    """Those gains of the observer that are not always zero, of each age, shape (100, k), and where they are."""

    values: Floats
    used: Any


@lru_cache(maxsize=32)
def _gains(observer: Observer) -> _Gains:
    estimator: Any = observer.estimator
    table = estimator.tables[observer.has_rates]
    used = table.any(axis=0)
    return _Gains(table[:, used], used)


@lru_cache(maxsize=32)
def observation_step(observer: Observer) -> Any:
    """Return equation (1).

    (measured, parameters, point, action, belief, sensing) → (next_belief, observation), where `measured` is y; belief
    and sensing are laid out as `Observer.values` returns them.
    """
    measured, parameters, point = (
        ca.SX.sym(*pair) for pair in zip(("y", "p", "point"), (STATE_SIZE, PARAMETERS_SIZE, POINT_SIZE), strict=True)
    )
    action, observed = ca.SX.sym("action", ACTION_SIZE), engines.observation_function()(measured, parameters, point)[0]
    observed = observed[np.arange(ALL.size)[ALL.select(observer.layout)].tolist()]
    if observer.period:
        belief, sensing = ca.SX.sym("belief", REMEMBERED_SIZE), ca.SX(0, 1)
        inputs, next_belief = remembered_of(observed, action, belief, observer.period)
        seen = [inputs]
    elif observer.estimator is None:
        belief, sensing = ca.SX(0, 1), ca.SX(0, 1)
        next_belief, seen = belief, [observed]
    else:
        belief, sensing, next_belief, seen = _estimated(observer, observed, point, action)
    observation = ca.vertcat(*seen)
    observation = ca.vertcat(observation, ca.SX(observer.size - observation.numel(), 1))
    arguments = [measured, parameters, point, action, belief, sensing]
    names = ["measured", "parameters", "point", "action", "belief", "sensing"]
    return ca.Function("observation_step", arguments, [next_belief, observation], names, ["next_belief", "observation"])


def _estimated(observer: Observer, observed: Any, point: Any, action: Any) -> tuple[Any, Any, Any, list[Any]]:
    """Return belief, sensing, the next belief, and the parts of the observation, for an observation `observed`."""
    estimator: Any = observer.estimator
    mass_share, packed_loop, packed_rigid = estimator.numbers
    loop, rigid = lift(unpack_loop)(packed_loop), None if packed_rigid is None else lift(unpack_rigid)(packed_rigid)
    rod_length, used = estimator.simulation.parameters.rod_length, _gains(observer).used
    belief = ca.SX.sym("belief", sum(observer.sizes))
    squares, last, filtered, estimate = ca.vertsplit(belief, np.cumsum([0, *observer.sizes]).tolist())
    sensing = ca.SX.sym("sensing", int(observer.situation) + int(used.sum()))
    gain = np.zeros(used.shape, object)
    gain[used] = ca.vertsplit(sensing[int(observer.situation) :])
    memory, buffer, chosen = columns(estimate), columns([], BUFFER_SIZE), Four(*ca.vertsplit(action))
    measured, reference = lift(measure)(columns(observed), 0, observer.has_rates, rod_length)
    lift(advance)(memory, 0, chosen, 0, loop, rigid, buffer)
    p, has_rates = loop.plant.pendulum.vehicle, observer.has_rates
    lift(correct)(memory, 0, measured, has_rates, reference, gain, mass_share, p, rigid, buffer)
    disturbance = vector(memory[DISTURBANCE:REFERENCE])
    disturbance[FORCE + 2] -= (memory[MASS_RATIO, 0] - 1.0) * estimator.simulation.parameters.hover_thrust
    later = memory.copy()
    if len(loop.parts) > 1:
        for k in range(1, len(loop.parts)):
            lift(advance)(later, 0, chosen, k, loop, rigid, buffer)
        lift(arrive)(later, 0, loop)
    if observer.law is not None:
        seen = [deviations_of(observer.law, later, bool(estimator.gains.mass_time))]
    else:
        state = lift(load_state)(later, STATE, 0)
        errors = lift(bob_offset)(state, rod_length)
        attitude = state.euler.x, state.euler.y, state.euler.z - later[YAW, 0]
        fields = vector((*errors, state.direction, state.direction_rate, attitude, state.euler_rate))
        reference = ca.SX(OBSERVATION_SIZE - REFERENCE_START, 1)
        seen = [fields / OBSERVATION_SCALE[:REFERENCE_START], reference, disturbance]
    if observer.situation:
        innovation = memory[INNOVATION:RIGID_PART].T
        new = mean_squares(innovation, columns(disturbance).T, columns(disturbance - last).T)
        squares, last = squares + sensing[0] * (vector(new) - squares), disturbance
        seen.append(ca.sqrt(ca.fmax(squares, _LEAST_SQUARE)))
    if observer.innovations:
        seen.append(innovations_of(memory, filtered, estimator.simulation.period))
        filtered = seen[-1][-FILTERED_SIZE:]
    return belief, sensing, ca.vertcat(squares, last, filtered, vector(memory)), seen
