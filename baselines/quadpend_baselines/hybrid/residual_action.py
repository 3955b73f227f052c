"""Hybrid whose policy adds a correction to the base controller's action (residual policy learning)."""

from typing import Any, ClassVar

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.base_controller import (
    MAGNIFICATION,
    change_simulation,
    check_action_scale,
    control_period,
    estimate,
    estimate_size,
    find_base_controller,
    magnify_state,
    name_of_base_controller,
)
from quadpend_baselines.hybrid.fallback import check_fallback_gain, update_anomaly_score, weigh_action
from quadpend_baselines.hybrid.protocol import HybridMemory
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE


class ResidualAction:
    """Hybrid that applies clip(a_base + κ a, −1, 1), equation (2) of `quadpend_baselines.hybrid.protocol`.

    The policy observes the base controller's estimates and its action. With a = 0 the base controller acts alone.

    Args:
        base_controller: A name from `quadpend_baselines.CONTROLLERS`, or a controller.
        action_scale: κ, in (0, 3].
        fallback_gain: γ of equation (4) in `quadpend_baselines.hybrid.fallback`, in [0, 10]; 0 disables the fallback.

    Raises:
        TypeError: If the controller does not estimate the disturbance.
        ValueError: If there is no controller with this name, or a number is out of range.
    """

    kind: ClassVar[str] = "residual_action"

    def __init__(
        self, base_controller: Any = "flatness", action_scale: float = 0.3, fallback_gain: float = 0.0
    ) -> None:
        """Find the base controller and check the numbers."""
        self.base_controller, self.base_controller_name = find_base_controller(base_controller)
        self.action_scale = check_action_scale(action_scale)
        self.fallback_gain = check_fallback_gain(fallback_gain)

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation; see `Hybrid.observation_size`."""
        return estimate_size(self.base_controller, size) + ACTION_SIZE

    def observe(
        self, observation: Floats32, memory: HybridMemory | None, episode_start: Any
    ) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`."""
        last, last_score = (None, None) if memory is None else (memory.controller, memory.anomaly_score)
        base_action, controller_memory = self.base_controller.predict(observation, last, episode_start)
        estimated, disturbance = estimate(self.base_controller, observation, controller_memory)
        period = control_period(self.base_controller)
        score = update_anomaly_score(self.fallback_gain, estimated, disturbance, last_score, episode_start, period)
        parts = [magnify_state(estimated), disturbance, MAGNIFICATION * base_action]
        return np.concatenate(parts, axis=1, dtype=np.float32), HybridMemory(controller_memory, base_action, score)

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the base controller's action and the memory; see `Hybrid.base_action`."""
        return memory.base_action, memory

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the corrected action and the memory; see `Hybrid.act`."""
        residual = np.float32(self.action_scale) * weigh_action(self.fallback_gain, action, memory.anomaly_score)
        applied = np.clip(memory.base_action + residual, -1.0, 1.0)
        return applied, memory._replace(controller=self.base_controller.with_applied_action(memory.controller, applied))

    def with_simulation(self, simulation: Simulation, loop: Loop | None = None) -> "ResidualAction":
        """Return this hybrid for another nominal simulation and loop; see `Hybrid.with_simulation`."""
        return change_simulation(self, simulation, loop)

    def as_data(self) -> dict[str, Any]:
        """Return plain data; see `Hybrid.as_data`."""
        return {
            "kind": self.kind,
            "base_controller": name_of_base_controller(self),
            "action_scale": self.action_scale,
            "fallback_gain": self.fallback_gain,
        }
