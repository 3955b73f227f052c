"""Hybrid whose policy acts alone and observes the base controller's estimates."""

from typing import Any, ClassVar

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.base_controller import (
    change_simulation,
    computes_action_later,
    control_period,
    estimate_size,
    find_base_controller,
    name_of_base_controller,
    observe_ahead,
)
from quadpend_baselines.hybrid.protocol import HybridMemory
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, situation_inputs, update_situation
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE


class EstimateOnly:
    """Hybrid whose policy acts alone, equation (1) of `quadpend_baselines.hybrid.protocol`.

    The policy observes the base controller's estimate of the disturbance, and that of the state at the time when the
    next action acts: with known delays and lags it is predicted through them.

    Args:
        base_controller: A name from `quadpend_baselines.CONTROLLERS`, or a controller.
        situation: Whether the policy also observes the situation, see `quadpend_baselines.hybrid.situation`.

    Raises:
        TypeError: If the controller does not estimate the disturbance, `situation` is not a boolean, or the controller
            has no innovations, which the situation needs.
        ValueError: If there is no controller with this name.
    """

    kind: ClassVar[str] = "estimate_only"

    def __init__(self, base_controller: Any = "adrc-matched", situation: bool = False) -> None:
        """Find the base controller."""
        self.base_controller, self.base_controller_name = find_base_controller(base_controller)
        if not isinstance(situation, bool):
            raise TypeError(f"situation must be true or false, not {situation!r}")
        if situation and not hasattr(self.base_controller, "innovation"):
            raise TypeError(f"situation needs a base_controller with a Kalman observer, not {base_controller!r}")
        self.situation = situation

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation; see `Hybrid.observation_size`."""
        return estimate_size(self.base_controller, size) + self.situation * SITUATION_SIZE

    def observe(
        self, observation: Floats32, memory: HybridMemory | None, episode_start: Any
    ) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`."""
        last = None if memory is None else memory.controller
        estimated, disturbance, controller_memory, action = observe_ahead(
            self.base_controller, observation, last, episode_start
        )
        base_action = np.zeros((len(observation), ACTION_SIZE), np.float32) if action is None else action
        observed: list[Any] = [estimated, disturbance]
        situation: Any = ()
        if self.situation:
            known = None if memory is None else memory.situation
            innovation, period = (
                self.base_controller.innovation(controller_memory),
                control_period(self.base_controller),
            )
            situation = update_situation(known, episode_start, innovation, disturbance, period)
            observed.append(situation_inputs(situation))
        policy_observation = np.concatenate(observed, axis=1, dtype=np.float32)
        return policy_observation, HybridMemory(controller_memory, base_action, np.zeros(len(observation)), situation)

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the base controller's action, which only imitation needs; see `Hybrid.base_action`."""
        if not computes_action_later(self.base_controller):
            return memory.base_action, memory
        action, controller_memory = self.base_controller.control(memory.controller)
        return action, memory._replace(controller=controller_memory)

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the policy's action unchanged and the memory; see `Hybrid.act`."""
        return action, memory._replace(controller=self.base_controller.with_applied_action(memory.controller, action))

    def with_simulation(self, simulation: Simulation, loop: Loop | None = None) -> "EstimateOnly":
        """Return this hybrid for another nominal simulation and loop; see `Hybrid.with_simulation`."""
        return change_simulation(self, simulation, loop)

    def as_data(self) -> dict[str, Any]:
        """Return plain data; see `Hybrid.as_data`."""
        data = {"kind": self.kind, "base_controller": name_of_base_controller(self)}
        return {**data, "situation": True} if self.situation else data
