"""What a policy observes, as a function of the flight and of the base controller's observer, for gradients.

The environment and its hybrid compute the values. CasADi reads the same equations, those of the observation, of the
observer and of the inputs (`common.lifted`), so that generated C has their slopes. A step of a row is

    (1)  y = x + n,   b ← g(b, a, y),   o = h(b, y)         n: error of the sensors, independent of the policy

with the belief b: the estimate of a Kalman observer, and the memories of the parts of the inputs. A delay of the
sensors is known: the flight ends with the last states, the oldest first. What other base controllers than those with a
Kalman observer estimate has no slope.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_baselines.estimation.estimate import AGE
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.estimation.samples import COASTS
from quadpend_baselines.hybrid.parts import InputPart
from quadpend_baselines.hybrid.situation import root
from quadpend_gym import engines
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines import lift, vector
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE
from quadpend_gym.tasks.observation import ALL, FULL, LAB, ObservationLayout
from quadpend_gym.tasks.references import POINT_SIZE
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE
from quadpend_train.common.lifted import advances, arrived, correction, errors, row, seen_by, with_reference_drag

_LEAST_SQUARE = 1e-8  # bounds the slope of a root mean square of the situation


def _bounded_root(mean_square: Any) -> Any:
    return root(np.maximum(mean_square, _LEAST_SQUARE))


class Observer(NamedTuple):
    """What the observation of a policy depends on."""

    estimator: Estimator | None  # None: there is no Kalman observer
    layout: ObservationLayout  # the fields of the environment's observation
    parts: tuple[InputPart, ...]  # of the policy's observation; without one it is the environment's
    size: int  # of the policy's observation; numbers beyond those of the parts have no slope

    @classmethod
    def of(cls, hybrid: Any, layout: ObservationLayout, size: int) -> "Observer":
        """Return the observer of a hybrid; None: there is no hybrid."""
        if hybrid is None:
            return cls(None, layout, (), size)
        if hybrid.reads != "estimates":
            return cls(None, layout, hybrid.parts(size), size)
        if hybrid.controller.observer == "kalman":
            return cls(hybrid.controller.estimator, layout, hybrid.parts(size), size)
        return cls(None, layout, (), size)

    @property
    def has_rates(self) -> bool:
        """Whether the environment's observation has velocities."""
        return self.layout == FULL

    def values(self, memory: Any) -> tuple[Floats, Floats]:
        """Return the beliefs in the memory of a hybrid, and the gains of the next step, both with n rows."""
        if self.estimator is None:
            none = np.zeros((len(memory.base_action), 0))
            return (memory.inputs if self.parts else none), none
        estimate, gains = memory.controller.estimate.array, _gains(self)
        return np.hstack([estimate, memory.inputs]), gains[
            np.minimum(estimate[:, AGE].astype(np.int64), len(gains) - 1)
        ]

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of the parts of a belief: the estimate, and the memories of the parts."""
        return 0 if self.estimator is None else self.estimator.size, sum(part.memory_size for part in self.parts)


@lru_cache(maxsize=32)
def _gains(observer: Observer) -> Floats:
    """Return those gains of the observer that are not always zero, of each age, shape (100, k).

    A sample that is missing has the slope of one that is not.
    """
    estimator: Any = observer.estimator
    table: Floats = estimator.tables[observer.has_rates]
    return table[:-COASTS, table.any(axis=0)]


@lru_cache(maxsize=32)
def observation_step(observer: Observer) -> Any:
    """Return equation (1).

    (measured, parameters, point, action, belief, sensing) → (next_belief, observation), where `measured` is y; belief
    and sensing are laid out as `Observer.values` returns them.
    """
    sizes = {"measured": STATE_SIZE, "parameters": PARAMETERS_SIZE, "point": POINT_SIZE, "action": ACTION_SIZE}
    sizes |= {"belief": sum(observer.sizes), "sensing": 0 if observer.estimator is None else _gains(observer).shape[1]}
    arguments = [ca.SX.sym(*pair) for pair in sizes.items()]
    measured, parameters, point, action, belief, sensing = arguments
    observed = engines.observation_function()(measured, parameters, point)[0]
    observed = observed[np.arange(ALL.size)[ALL.select(observer.layout)].tolist()]
    memory, extra = ca.vertsplit(belief, np.cumsum([0, *observer.sizes]).tolist())
    later, seen = row(memory), observed
    if observer.estimator is not None:
        functions, (first, *rest) = advances(observer.estimator.prediction, observer.estimator.size)
        correct = correction(observer.estimator, observer.layout)
        memory = correct(functions[first](memory, action), observed, sensing)
        ahead = memory
        for name in rest:
            ahead = functions[name](ahead, action)
        later = with_reference_drag(arrived(ahead, observer.estimator.prediction), observer.estimator.prediction)
    if observer.parts:
        known = observed
        if observer.layout == LAB and observer.estimator is not None:
            known = errors(observed, observer.estimator.simulation.parameters)
        now = memory
        if observer.estimator is not None:
            now = vector(with_reference_drag(row(memory), observer.estimator.prediction))
        given = known, action, ca.SX(ACTION_SIZE, 1), now, later, extra
        seen, extra = seen_by(observer.parts, *given, {root: lift(_bounded_root)})
    observation = ca.vertcat(seen, ca.SX(observer.size - seen.numel(), 1))
    results, names = [ca.vertcat(memory, extra), observation], ["next_belief", "observation"]
    return ca.Function("observation_step", arguments, results, list(sizes), names)
