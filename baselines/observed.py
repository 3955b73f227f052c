"""A control law that needs the whole state, flown from observations: `estimator` in front of it."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from baselines.estimator import Estimate, Estimator, Reading, read
from baselines.policy import choose, started_rows, to_action
from quadpend_gym import Simulation
from quadpend_gym.arrays import Floats, Floats32


class Law(Protocol):
    """Thrust and torques from what is estimated."""

    def first(self, rows: int) -> Any:
        """What the law remembers at the start of an episode: arrays of `rows` rows, or tuples of such."""

    def command(self, estimate: Estimate, reading: Reading, memory: Any) -> tuple[Floats, Any]:
        """Thrust (N) and torques (N·m), shape (n, 4), as yet without limits, and what the law remembers."""


class ObservedMemory(NamedTuple):
    """What an observed law remembers from one call to the next, for n rows."""

    estimate: Estimate
    command: Floats  # thrust and torques really given, (n, 4)
    law: Any


class Observed:
    """A law as a policy with the `predict` protocol.

    Args:
        law: makes the law of its gains and of what is believed of the plant.
        gains: of the law; their field `estimator` has the estimator's.
        simulation: what is believed of the plant and its actuators, and the period.
    """

    def __init__(self, law: Callable[[Any, Simulation], Law], gains: Any, simulation: Simulation | None = None) -> None:
        """Design estimator and law."""
        self.law, self.gains, self.simulation = law, gains, simulation or Simulation()
        self._law = law(gains, self.simulation)
        self._estimator = Estimator(gains.estimator, self.simulation)

    def told(self, simulation: Simulation) -> "Observed":
        """The same controller with another belief of the plant."""
        return Observed(self.law, self.gains, simulation)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, ObservedMemory]:
        """Action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        rod_length = self.simulation.parameters.rod_length
        reading = read(np.atleast_2d(np.asarray(observation, np.float32)), rod_length)
        rows = len(reading.state)
        started = started_rows(episode_start, state is None, rows)
        known: Any = None
        if not started.all():
            known = self._estimator.update(state.estimate, state.command, reading), state.law
        if started.any():
            fresh = self._estimator.first(reading), self._law.first(rows)
            known = fresh if known is None else choose(started, fresh, known)
        estimate, memory = known
        command, memory = self._law.command(estimate, reading, memory)
        action, command = to_action(command, self.simulation)
        return (action[0] if single else action), ObservedMemory(estimate, command, memory)

    def estimated_disturbance(self, memory: ObservedMemory) -> Floats:
        """The disturbance as the estimator sees it, laid out as `info["disturbance"]`, shape (n, 9)."""
        return memory.estimate.disturbance
