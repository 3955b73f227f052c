"""A control law that needs the whole state, flown from observations: `estimator` in front of it."""

from collections.abc import Callable
from inspect import signature
from typing import Any, NamedTuple, Protocol

import numpy as np

from quadpend_baselines.estimation.estimator import (
    Estimate,
    Estimator,
    Measurement,
    measurement_from_observation,
    observation_from_state,
)
from quadpend_baselines.policy.protocol import episode_start_mask, select_rows, to_action, to_command
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32


class ControlLaw(Protocol):
    """Thrust and torques from what is estimated."""

    def initial_memory(self, rows: int) -> Any:
        """What the law remembers at the start of an episode: arrays of `rows` rows, or tuples of such."""

    def command(self, estimate: Estimate, measurement: Measurement, memory: Any) -> tuple[Floats, Any]:
        """Thrust (N) and torques (N·m), shape (n, 4), as yet without limits, and what the law remembers."""


class Estimation(NamedTuple):
    """What there is to decide on, for n rows."""

    measurement: Measurement
    estimate: Estimate
    law: Any  # what the law remembers


class OutputFeedbackMemory(NamedTuple):
    """What an observed law remembers from one call to the next, for n rows."""

    estimate: Estimate
    command: Floats  # thrust and torques really given, (n, 4)
    law: Any


class OutputFeedback:
    """A law as a policy with the `predict` protocol.

    Args:
        law: makes the law of its gains and of what is believed of the plant.
        gains: of the law; their field `estimator` has the estimator's.
        simulation: what is believed of the plant and its actuators, and the period.
    """

    def __init__(
        self, law: Callable[[Any, Simulation], ControlLaw], gains: Any, simulation: Simulation | None = None
    ) -> None:
        """Design estimator and law."""
        self.law, self.gains, self.simulation = law, gains, simulation or Simulation()
        self._law = law(gains, self.simulation)
        self._estimator = Estimator(gains.estimator, self.simulation)

    @property
    def has_bandwidth_scale(self) -> bool:
        """Whether the law's bandwidths can be steered: its `command` takes a `pace`."""
        return "bandwidth_scale" in signature(self._law.command).parameters

    def with_simulation(self, simulation: Simulation) -> "OutputFeedback":
        """The same controller with another belief of the plant."""
        return OutputFeedback(self.law, self.gains, simulation)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, OutputFeedbackMemory]:
        """Action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        known = self.update(np.atleast_2d(np.asarray(observation, np.float32)), state, episode_start)
        action, memory = self.control(known)
        return (action[0] if single else action), memory

    def update(self, observation: Floats32, state: OutputFeedbackMemory | None, episode_start: Any) -> Estimation:
        """What is known with n observations, shape (n, 36) or (n, 27); the rest as in `predict`."""
        measurement = measurement_from_observation(observation, self.simulation.parameters.rod_length)
        rows = len(measurement.state)
        started = episode_start_mask(episode_start, state is None, rows)
        known: Any = None
        if state is not None and not started.all():
            known = self._estimator.update(state.estimate, state.command, measurement), state.law
        if started.any():
            fresh = self._estimator.initial_estimate(measurement), self._law.initial_memory(rows)
            known = fresh if known is None else select_rows(started, fresh, known)
        return Estimation(measurement, *known)

    def control(self, known: Estimation, **more: Any) -> tuple[Floats32, OutputFeedbackMemory]:
        """Actions of n rows, shape (n, 4), and memory; `more` goes to the law's `command`."""
        command, memory = self._law.command(known.estimate, known.measurement, known.law, **more)
        action, command = to_action(command, self.simulation)
        return action, OutputFeedbackMemory(known.estimate, command, memory)

    def estimated_disturbance(self, memory: OutputFeedbackMemory | Estimation) -> Floats:
        """The disturbance as the estimator sees it, laid out as `info["disturbance"]`, shape (n, 9)."""
        return memory.estimate.disturbance

    def estimated_observation(self, observation: Floats32, memory: OutputFeedbackMemory | Estimation) -> Floats32:
        """The observation that the estimator's state would give, shape (n, 36), also of one without velocities (27)."""
        return observation_from_state(memory.estimate.state, observation, self.simulation.parameters.rod_length)

    def with_applied_action(self, memory: OutputFeedbackMemory, action: Floats32) -> OutputFeedbackMemory:
        """What is remembered if `action`, shape (n, 4), acts and not the law's own."""
        return memory._replace(command=to_command(action, self.simulation))
