"""The known part of the control loop: delays, lags and rate limits between the controller and the plant.

A controller that knows these models applies them to its own actions. All of them are time-invariant, so their delays
can be taken together and put first. A delay of the sensors by d control steps is, for an observer of the delayed state
z_k = x_{k−d}, one more delay of the actions:

    (1)  x_{k+1} = f(x_k, a_k)   ⟹   z_{k+1} = f(z_k, a_{k−d})

A lag T is compensated down to `FASTEST_LAG` T': the action

    (2)  a = y + (w − y) (1 − e^(−h/T'))/(1 − e^(−h/T))               h: control period, y: lagged action, T > T'

moves y towards the wanted action w as a lag of T' does. The estimator predicts through the remaining lag.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag, RateLimit, Rotors
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.streams import Streams
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay

FASTEST_LAG = 0.02  # s, T': faster ones amplify noise, slower ones track less well; measured with `flatness`


@dataclass(frozen=True)
class Loop:
    """The known part of a loop.

    Attributes:
        delay: Control steps from the choice of an action to the step in which it begins to act, by the actuators.
        actuators: Models of the types `MotorLag` and `RateLimit`, in the order in which they act after the delay.
        sensor_delay: Control steps from a state to its measurement.
    """

    delay: int = 0
    actuators: tuple[Any, ...] = ()
    sensor_delay: int = 0

    @classmethod
    def of(cls, sensors: Iterable[Any] = (), actuators: Iterable[Any] = ()) -> "Loop":
        """Return the known part of a loop; all other models, for example noise and faults, are left out.

        Args:
            sensors: Sensor models.
            actuators: Actuator models. If `Rotors` is among them, delays and lags act on the thrusts of the rotors,
                which is the same as on thrust and torques; rate limits are then left out.
        """
        models = tuple(actuators)
        mixed = any(isinstance(model, Rotors) for model in models)
        known = MotorLag if mixed else MotorLag | RateLimit
        return cls(
            sum(model.steps for model in models if isinstance(model, ActionDelay)),
            tuple(model for model in models if isinstance(model, known)),
            sum(model.steps for model in sensors if isinstance(model, Delay)),
        )

    @classmethod
    def known(cls, scenario: Scenario) -> "Loop":
        """Return the part of a scenario's loop that controllers know."""
        return cls.of(scenario.sensors, scenario.actuators) if scenario.loop_known else cls()

    @property
    def steps(self) -> int:
        """Control steps from the choice of an action to the step in which the estimated state begins to follow it."""
        return self.delay + self.sensor_delay

    @property
    def lag(self) -> float:
        """Sum of the time constants of the compensated lags, s."""
        lags = [min(model.time_constant, FASTEST_LAG) for model in self.actuators if isinstance(model, MotorLag)]
        return float(sum(lags))

    @property
    def memory_size(self) -> int:
        """Number of floats that `act` stores for each row."""
        return self.steps * ACTION_SIZE + sum(int(model.memory_size) for model in self.actuators)

    def act(self, action: Floats32, memory: Floats, simulation: Simulation) -> tuple[Floats32, Floats]:
        """Return the action that acts in a control step, shape (n, 4), and the memory after this step.

        Args:
            action: The action that the controller has chosen in this step, shape (n, 4).
            memory: The memory before the step, shape (n, k): the actions under way, the oldest first, and the memory of
                each actuator. It is zero at the start of an episode.
            simulation: Defines the control period.
        """
        if not self.memory_size:
            return action, memory
        first = self.steps * ACTION_SIZE
        under_way = np.concatenate([memory[:, :first], action], axis=1)
        out, after = np.asfortranarray(under_way[:, :ACTION_SIZE]), [under_way[:, ACTION_SIZE:]]
        # These models use neither the step number nor random numbers.
        step, streams = np.zeros(len(action), np.int64), Streams(np.zeros(len(action), np.uint64))
        for model in self.actuators:
            part = np.array(memory[:, first : first + model.memory_size], order="F")
            model.act(out, part, step, simulation, streams)
            after.append(part)
            first += model.memory_size
        return out.astype(np.float32, order="C"), np.concatenate(after, axis=1)

    def compensate(self, wanted: Floats32, memory: Floats, period: float) -> Floats32:
        """Return the action of equation (2), clipped to its range, shape (n, 4).

        Args:
            wanted: w, shape (n, 4).
            memory: The memory at the time when the action acts, shape (n, k).
            period: h, s.
        """
        last = self.memory_size
        for model in reversed(self.actuators):
            lagged, last = memory[:, last - model.memory_size : last], last - model.memory_size
            if isinstance(model, MotorLag) and model.time_constant > FASTEST_LAG:
                factor = np.expm1(-period / FASTEST_LAG) / np.expm1(-period / model.time_constant)
                wanted = np.clip(lagged + factor * (wanted - lagged), -1.0, 1.0).astype(np.float32)
        return wanted
