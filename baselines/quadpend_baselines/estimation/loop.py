"""The known part of the control loop: delays and lags between the controller and the plant.

A controller that knows these models applies them to its own actions. All of them are time-invariant, so their delays
can be taken together and put first. A delay of the sensors by d control steps is, for an observer of the delayed state
z_k = x_{k−d}, one more delay of the actions:

    (1)  x_{k+1} = f(x_k, a_k)   ⟹   z_{k+1} = f(z_k, a_{k−d})
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quadpend_gym.actuators import ActionDelay, MotorLag, lag_shares
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay, Noise
from quadpend_gym.tasks.observation import FULL, LAB, OUTPUT_FEEDBACK, ObservationLayout

READABLE = FULL, LAB, OUTPUT_FEEDBACK  # what controllers read, the preferred ones first


@dataclass(frozen=True)
class Loop:
    """The known part of a loop.

    Attributes:
        delay: Control steps from the choice of an action to the step in which it begins to act, by the actuators.
        lags: Time constants of the `MotorLag`s, which act after the delay, s.
        sensor_delay: Control steps from a state to its measurement.
        noise: Standard deviations of the white noise of position (m), Euler angles (rad) and direction (rad).
        observation: The fields that the controller reads, `FULL`, `LAB` or `OUTPUT_FEEDBACK`.
    """

    delay: int = 0
    lags: tuple[float, ...] = ()
    sensor_delay: int = 0
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    observation: ObservationLayout = FULL

    @classmethod
    def of(cls, sensors: Iterable[Any] = (), actuators: Iterable[Any] = ()) -> "Loop":
        """Return the known part of a loop; other models of sensors and actuators, such as biases, are left out."""
        models, sensors = tuple(actuators), tuple(sensors)
        noise = np.zeros(3)
        for model in sensors:
            if isinstance(model, Noise):
                a, b = model.level or (1.0, 1.0)
                white = np.array([model.position.white, model.euler.white, model.direction.white])
                noise += white**2 * (a * a + a * b + b * b) / 3.0
        return cls(
            sum(model.steps for model in models if isinstance(model, ActionDelay)),
            tuple(model.time_constant for model in models if isinstance(model, MotorLag)),
            sum(model.steps for model in sensors if isinstance(model, Delay)),
            tuple(np.sqrt(noise).tolist()),
        )

    @classmethod
    def known(cls, scenario: Scenario) -> "Loop":
        """Return the part of a scenario's loop that controllers know, and what they read of its observation."""
        loop = cls.of(scenario.sensors, scenario.actuators) if scenario.loop_known else cls()
        seen = set(scenario.observation)
        observation = next((item for item in READABLE if set(item) <= seen), OUTPUT_FEEDBACK)
        return replace(loop, observation=observation)

    @property
    def has_rates(self) -> bool:
        """Whether velocities are observed."""
        return self.observation == FULL

    @property
    def in_world(self) -> bool:
        """Whether positions in the world are observed, with the age of the sample, and not errors alone."""
        return self.observation == LAB

    @property
    def of_errors(self) -> "Loop":
        """The same for a policy that reads errors in place of positions in the world."""
        return replace(self, observation=OUTPUT_FEEDBACK if self.in_world else self.observation)

    @property
    def steps(self) -> int:
        """Control steps from the choice of an action to the step in which the estimated state begins to follow it."""
        return self.delay + self.sensor_delay

    def numbers(self, period: float) -> Floats:
        """Return what each lag leaves of a − y in the mean over a period (s), and at its end: shares, shape (k, 2)."""
        return np.array([lag_shares(period / time_constant) for time_constant in self.lags]).reshape(-1, 2)


@inlined
def act(action: Any, delay: int, lags: Any, memory: Any, first: int, lane: int) -> None:
    """Replace the action that the controller has chosen in a control step by the one that acts, in place.

    `lags` are `Loop.numbers`, k of them. The memory begins with field `first`: the actions under way, the oldest first,
    and the action behind each lag, 4 (delay + k) numbers. It is zero at the start of an episode.
    """
    waiting = ACTION_SIZE * delay
    for i in range(ACTION_SIZE):
        if delay > 0:
            chosen, action[i, 0] = action[i, 0], memory[first + i, lane]
            for k in range(first + i, first + waiting - ACTION_SIZE, ACTION_SIZE):
                memory[k, lane] = memory[k + ACTION_SIZE, lane]
            memory[first + waiting - ACTION_SIZE + i, lane] = chosen
        for k in range(lags.shape[0]):
            place = first + waiting + ACTION_SIZE * k + i
            wanted, last = action[i, 0], memory[place, lane]
            memory[place, lane] = wanted + lags[k, 1] * (last - wanted)
            action[i, 0] = wanted + lags[k, 0] * (last - wanted)
        action[i, 0] = float(np.float32(action[i, 0]))
