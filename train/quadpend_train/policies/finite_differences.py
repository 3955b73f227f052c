"""Flying where velocities are hidden with a policy that wants to see them."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_gym import OBSERVATION_FIELDS, read_observation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.tasks.observation import OBSERVATION_SCALE, OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS

# what is measured, and its rate
_RATES = {"tracking_error": "tracking_error_rate", "direction": "direction_rate", "attitude": "euler_rate"}


class _Memory(NamedTuple):
    policy: Any
    measured: dict[str, Floats]  # the last values, (n, 3) each


class FiniteDifferencePolicy:
    """`policy` for an environment behind `OutputFeedbackWrapper`: differences of two observations stand for rates.

    At the beginning of an episode errors and direction are taken to rest.

    Args:
        policy: anything that predicts from the whole observation.
        period: of a control step, s.
    """

    def __init__(self, policy: Policy, period: float) -> None:
        """Wrap `policy`."""
        self.policy = policy
        self.period = period

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Action and memory for observations of shape (n, 27); see `Policy.predict`."""
        started = episode_start_mask(episode_start, state is None, len(observation))[:, np.newaxis]
        measured = {name: read_observation(observation, name) for name in _RATES}
        whole = np.empty((len(observation), OBSERVATION_SIZE), np.float32)
        whole[:, OUTPUT_FEEDBACK_COLUMNS] = observation
        for name, value in measured.items():
            last = value if state is None else np.where(started, value, state.measured[name])
            rate = (value - last) / self.period
            if name == "attitude":  # whose yaw is an error, while its rate is ψ̇
                rate[:, 2] += read_observation(observation, "yaw_reference")[:, 1]
            place = OBSERVATION_FIELDS[_RATES[name]]
            whole[:, place] = rate / OBSERVATION_SCALE[place]
        action, memory = self.policy.predict(whole, state and state.policy, episode_start, deterministic)
        return action, _Memory(memory, measured)
