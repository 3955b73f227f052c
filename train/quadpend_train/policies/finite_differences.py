"""Finite differences, for a policy that needs velocities in an environment that does not observe them."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.estimation.feeding import FedErrors, fed_by_name
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.policy.protocol import PolicyWrapper, episode_start_mask
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK, ObservationLayout

# Fields of rates and the fields of which they are the rates.
_RATES = {"tracking_error_rate": "tracking_error", "direction_rate": "direction", "euler_rate": "attitude"}


def _differences(
    numbers: tuple[ObservationLayout, ObservationLayout, float], seen: Seen, memory: Any
) -> tuple[Any, Any]:
    read, given, period = numbers
    full, continues = np.empty((len(memory), read.size)), memory[:, -1:] >= 1.0
    values: list[Any] = []
    for name, columns in read.columns.items():
        source = given.columns[name if name in given else _RATES[name]]
        if name in given:
            full[:, columns] = seen.observation[:, source]
            continue
        value, first = seen.observation[:, source] * given.scale[source], 3 * len(values)
        rate = (value - np.where(continues, memory[:, first : first + 3], value)) / period
        if (
            name == "euler_rate"
        ):  # the third number of the attitude is the yaw error, but the rate is that of the yaw, ψ̇
            yaw_rate = given.columns["yaw_reference"].start + 1
            rate[:, 2] += seen.observation[:, yaw_rate] * given.scale[yaw_rate]
        full[:, columns] = rate / read.scale[columns]
        values.append(value)
    return full, np.concatenate([*values, np.ones((len(full), 1))], axis=1)


def difference_part(read: ObservationLayout, seen: ObservationLayout, period: float) -> InputPart:
    """Return the fields `read` of which the rates are differences, for an observation of the fields `seen`.

    The memory has the last values, and 1 after the first step of an episode. The control period is in s.
    """
    rates = sum(name not in seen for name in read)
    return InputPart(read.size, 3 * rates + 1, _differences, (read, seen, period))


class _Memory(NamedTuple):
    policy: Any
    inputs: Floats  # of the part


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
        self.part = difference_part(read, seen, period)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory for observations of shape (n, m); see `quadpend_baselines.Policy.predict`."""
        started = episode_start_mask(episode_start, state is None, len(observation))[:, np.newaxis]
        last = np.where(started, 0.0, np.zeros((1, self.part.memory_size)) if state is None else state.inputs)
        full, after = self.part.function(self.part.numbers, Seen(observation, *[None] * 4), last)
        given = full.astype(np.float32), state and state.policy
        action, memory = self.policy.predict(*given, episode_start, deterministic)
        return action, _Memory(memory, after)


def with_velocities(policy: Policy, scenario: Scenario) -> Policy:
    """Return a policy for a scenario by the names of its fields; rates that are not observed are differences."""
    seen = scenario.observation
    in_world = set(LAB) <= set(seen)
    known = {*seen, *OUTPUT_FEEDBACK} if in_world else set(seen)
    if policy.layouts is None or any(set(layout) <= known for layout in policy.layouts):
        return fed_by_name(policy, scenario)
    read = policy.layouts[0]
    needed = {_RATES.get(name, name) for name in read if name not in seen}
    if "attitude" in needed:
        needed.add("yaw_reference")
    period = scenario.simulation.period
    if needed <= set(OUTPUT_FEEDBACK) and in_world:
        differences: Policy = FiniteDifferencePolicy(policy, read, OUTPUT_FEEDBACK, period)
        return FedErrors(differences, seen.select(LAB), slice(None), scenario.simulation.parameters)
    return FiniteDifferencePolicy(policy, read, seen, period) if needed <= set(seen) else fed_by_name(policy, scenario)
