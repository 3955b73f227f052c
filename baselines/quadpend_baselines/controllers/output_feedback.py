"""Output feedback: a control law that uses the state and disturbance estimates of `estimation.kalman`."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.controllers.law import Law
from quadpend_baselines.estimation.estimate import Estimate, disturbance_of, nominal
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.prediction import Prediction
from quadpend_baselines.policy.protocol import episode_start_mask, select_rows
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import ACTION_SIZE, THRUST


class OutputFeedbackMemory(NamedTuple):
    """Memory of an `OutputFeedback` policy for n rows."""

    estimate: Estimate  # the estimate after the latest measurement
    law_memory: Any  # the memory of the control law
    action: Floats32  # the latest action, shape (n, 4); zeros at the start of an episode


def actions_of(law: Law, simulation: Simulation, estimate: Estimate, memory: Any) -> tuple[Floats32, Any]:
    """Return the actions of a law, shape (n, 4), and its memory, for the estimate at the time when the actions act."""
    command, after = law.command(nominal(estimate), memory)
    mass_ratio = estimate.mass_ratio[:, 0]
    if law.commands_actions:
        command[:, THRUST] = mass_ratio * (1.0 + command[:, THRUST]) - 1.0
        return np.clip(command, -1.0, 1.0).astype(np.float32), after
    command[:, THRUST] *= mass_ratio
    return plant_of(simulation).actions_for(command, estimate.rigid), after


class OutputFeedback(Controller):
    """A control law and an estimator as a policy with the `predict` protocol.

    Args:
        make_law: Returns the control law from its gains and the nominal simulation.
        gains, simulation, loop: As of `Controller`.
    """

    def __init__(
        self,
        make_law: Callable[[Any, Simulation], Law],
        gains: Any,
        simulation: Simulation | None = None,
        loop: Loop | None = None,
    ) -> None:
        super().__init__(gains, simulation, loop)
        self.make_law, self._law = make_law, make_law(self.gains, self.simulation)
        self.has_linear_model, self.flies_load = self._law.has_linear_model, self._law.flies_load
        self.observer, self.has_c = self._law.observer, self._law.has_c
        self.estimator = self._law.estimator(self.loop)

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "OutputFeedback":
        """Return the same controller, designed for another nominal simulation and loop."""
        return OutputFeedback(self.make_law, self.given_gains, simulation, loop)

    def act(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, OutputFeedbackMemory]:
        """Return actions and memory; see `Controller.act`."""
        return self.control(self.update(observation, state, episode_start))

    def update(
        self, observation: Floats32, state: OutputFeedbackMemory | None, episode_start: Any
    ) -> OutputFeedbackMemory:
        """Update the estimates with new observations, shape (n, 36), or (n, 27) without velocities."""
        rows = len(observation)
        if state is None:
            estimate, none = self.estimator.observe(observation), np.zeros((rows, ACTION_SIZE), np.float32)
            return OutputFeedbackMemory(estimate, self._law.initial_memory(rows), none)
        started = None if episode_start is None else episode_start_mask(episode_start, False, rows)
        estimate = self.estimator.observe(observation, state.estimate, state.action, started)
        law_memory, action = state.law_memory, state.action
        if started is not None and started.any():
            initial = self._law.initial_memory(rows), np.zeros_like(action)
            law_memory, action = select_rows(started, initial, (law_memory, action))
        return OutputFeedbackMemory(estimate, law_memory, action)

    def control(self, estimation: OutputFeedbackMemory) -> tuple[Floats32, OutputFeedbackMemory]:
        """Return the actions of n rows, shape (n, 4), and the memory."""
        later = self.estimator.prediction.carry_forward(estimation.estimate, estimation.action)
        action, law_memory = actions_of(self._law, self.simulation, later, estimation.law_memory)
        return action, OutputFeedbackMemory(estimation.estimate, law_memory, action)

    def estimated_disturbance(self, memory: OutputFeedbackMemory) -> Floats:
        """Return the estimated disturbance, N and N·m, shape (n, 9), see `estimate.disturbance_of`."""
        return disturbance_of(memory.estimate.array, self.simulation.parameters.hover_thrust)

    def estimates(self, memory: OutputFeedbackMemory) -> tuple[Floats, Floats]:
        """Return the estimate now, and at the time when the next action acts, shapes (n, k), for networks."""
        prediction: Prediction = self.estimator.prediction
        later = prediction.carry_forward(memory.estimate, memory.action)
        return prediction.with_reference_drag(memory.estimate).array, prediction.with_reference_drag(later).array

    def with_applied_action(self, memory: OutputFeedbackMemory, action: Floats32) -> OutputFeedbackMemory:
        """Return the memory for the case that `action`, shape (n, 4), is applied instead of the controller's action."""
        return OutputFeedbackMemory(memory.estimate, memory.law_memory, action)
