"""Finite differences, for a policy that needs velocities in an environment that does not observe them."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import PolicyWrapper, episode_start_mask, fed_by_name
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import ObservationLayout

# Fields of rates and the fields of which they are the rates.
_RATES = {"tracking_error_rate": "tracking_error", "direction_rate": "direction", "euler_rate": "attitude"}


class _Memory(NamedTuple):
    policy: Any
    outputs: dict[str, Floats]  # the last values of the observed fields, shape (n, 3) each


class FiniteDifferencePolicy(PolicyWrapper):
    """A policy that reads rates which are not observed, and computes them from two successive observations.

    At the first step of an episode the rates of the tracking error, the direction and the roll and pitch angles are
    zero, and the yaw rate is that of the reference.

    Args:
        policy: The policy.
        read: The fields that it reads.
        seen: The fields that are observed.
        period: The control period, s.
    """

    def __init__(self, policy: Policy, read: ObservationLayout, seen: ObservationLayout, period: float) -> None:
        super().__init__(policy)
        self.read, self.seen, self.period = read, seen, period
        self._sources = {name: _RATES[name] for name in read if name not in seen}

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory for observations of shape (n, m); see `quadpend_baselines.Policy.predict`."""
        started = episode_start_mask(episode_start, state is None, len(observation))[:, np.newaxis]
        outputs = {name: self.seen.read(observation, name) for name in self._sources.values()}
        full = np.empty((len(observation), self.read.size), np.float32)
        for name, columns in self.read.columns.items():
            if name in self.seen:
                full[:, columns] = observation[:, self.seen.columns[name]]
                continue
            value = outputs[source := self._sources[name]]
            last = value if state is None else np.where(started, value, state.outputs[source])
            rate = (value - last) / self.period
            if source == "attitude":  # its third number is the yaw error, but that of euler_rate is the yaw rate ψ̇
                rate[:, 2] += self.seen.read(observation, "yaw_reference")[:, 1]
            full[:, columns] = rate / self.read.scale[columns]
        action, memory = self.policy.predict(full, state and state.policy, episode_start, deterministic)
        return action, _Memory(memory, outputs)

    def estimated_disturbance(self, memory: Any) -> Floats:
        """Return the estimate of the wrapped policy."""
        return self.policy.estimated_disturbance(memory.policy)


def with_velocities(policy: Policy, scenario: Scenario) -> Policy:
    """Return a policy for a scenario by the names of its fields; rates that are not observed are differences."""
    seen = scenario.observation
    if policy.layouts is None or any(set(layout) <= set(seen) for layout in policy.layouts):
        return fed_by_name(policy, scenario)
    read = policy.layouts[0]
    needed = {_RATES.get(name, name) for name in read if name not in seen}
    if "attitude" in needed:
        needed.add("yaw_reference")
    if not needed <= set(seen):
        return fed_by_name(policy, scenario)
    return FiniteDifferencePolicy(policy, read, seen, scenario.simulation.period)
