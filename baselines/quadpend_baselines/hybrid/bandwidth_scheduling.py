"""Hybrid whose policy scales the bandwidths of the base controller (gain scheduling)."""

from typing import Any, ClassVar

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.base_controller import (
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


class BandwidthScheduling:
    """Hybrid whose policy scales bandwidths, equation (3) of `quadpend_baselines.hybrid.protocol`.

    The four components of the policy's action belong to the bandwidths of position, pendulum, attitude, and of height
    and yaw together. A component a multiplies its bandwidth by (1 + κ)^a. With a = 0 the base controller keeps its
    nominal gains.

    Args:
        base_controller: ``"flatness"``, or a flatness-based controller with other gains.
        action_scale: κ, in (0, 3].
        fallback_gain: γ of equation (4) in `quadpend_baselines.hybrid.fallback`, in [0, 10]; 0 disables the fallback.

    Raises:
        TypeError: If the controller has no bandwidths that can be scaled.
        ValueError: If there is no controller with this name, or a number is out of range.
    """

    kind: ClassVar[str] = "bandwidth_scheduling"

    def __init__(
        self, base_controller: Any = "flatness", action_scale: float = 1.0, fallback_gain: float = 0.0
    ) -> None:
        """Find the base controller and check the numbers."""
        self.base_controller, self.base_controller_name = find_base_controller(base_controller)
        if not getattr(self.base_controller, "has_bandwidth_scale", False):
            raise TypeError(f"only the flatness-based controller has bandwidths to scale, not {base_controller!r}")
        self.action_scale = check_action_scale(action_scale)
        self.fallback_gain = check_fallback_gain(fallback_gain)

    def observation_size(self, size: int) -> int:
        """Return the size of the policy's observation; see `Hybrid.observation_size`."""
        return estimate_size(self.base_controller, size)

    def observe(
        self, observation: Floats32, memory: HybridMemory | None, episode_start: Any
    ) -> tuple[Floats32, HybridMemory]:
        """Return the policy's observation and the memory; see `Hybrid.observe`.

        The base controller computes its action in `act`, with the scaled bandwidths. Until then `base_action` is zero.
        """
        last, last_score = (None, None) if memory is None else (memory.controller, memory.anomaly_score)
        controller_memory = self.base_controller.update(observation, last, episode_start)
        estimated, disturbance = estimate(self.base_controller, observation, controller_memory)
        period = control_period(self.base_controller)
        score = update_anomaly_score(self.fallback_gain, estimated, disturbance, last_score, episode_start, period)
        policy_observation = np.concatenate([magnify_state(estimated), disturbance], axis=1, dtype=np.float32)
        return policy_observation, HybridMemory(
            controller_memory, np.zeros((len(observation), ACTION_SIZE), np.float32), score
        )

    def base_action(self, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the base controller's action and the memory; see `Hybrid.base_action`."""
        return memory.base_action, memory

    def act(self, action: Floats32, memory: HybridMemory) -> tuple[Floats32, HybridMemory]:
        """Return the base controller's action with scaled bandwidths and the memory; see `Hybrid.act`."""
        exponent = weigh_action(self.fallback_gain, action, memory.anomaly_score).astype(np.float64)
        scales = (1.0 + self.action_scale) ** exponent
        applied, controller_memory = self.base_controller.control(memory.controller, bandwidth_scale=scales)
        return applied, HybridMemory(controller_memory, applied, memory.anomaly_score)

    def with_simulation(self, simulation: Simulation, loop: Loop | None = None) -> "BandwidthScheduling":
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
