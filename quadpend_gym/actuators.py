"""Actuator models: they change the action between the policy and the quadrotor.

Several actuators act in the order in which they are listed: ``[ActionDelay(2), MotorLag(0.05)]`` delays the policy's
action and applies the lag of the motors. The effort term of the reward is computed from the result.
"""

from functools import cached_property
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.delays import delay, hold
from quadpend_gym.core.events import Interruptions
from quadpend_gym.core.models import FromFactory, Model, Registry, ZeroInitialized
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.vehicles import Simulation


@runtime_checkable
class Actuator(Model, Protocol):
    """The interface of an actuator model, for a batch of n sub-environments. A base class is not needed."""

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Change the actions of the next control period, in [−1, 1], shape (n, 4), columns contiguous, in place.

        The simulation has the control period, the nominal parameters and the command limits. The other arguments are
        those of `Wind.sample`.
        """


@settings
class ActuatorFromFactory(FromFactory):
    """The actuators that a function or class of the user's own code returns."""

    @cached_property
    def parts(self) -> Any:
        """The models that the factory returns."""
        return ACTUATORS.make_own(self.kind)

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Change the actions, each model in its turn."""
        self.each(memory, streams, lambda model, own, random: model.act(action, own, step, simulation, random))


ACTUATORS = Registry("actuator", Actuator, ActuatorFromFactory)
ActuatorsField = ACTUATORS.field()  # annotation of a field that holds a tuple of actuators
as_actuators, KINDS = ACTUATORS.parse, ACTUATORS.kinds


@ACTUATORS.add
@settings
class ActionDelay(ZeroInitialized):
    """A transport delay of `steps` control steps. During the first `steps` steps of an episode the action is hover."""

    steps: Annotated[int, Range(1, 1000)] = 1  # delay in control steps
    kind: Literal["action_delay"] = "action_delay"

    @property
    def memory_size(self) -> int:
        """Four numbers for each delayed step."""
        return self.steps * ACTION_SIZE

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Replace the action by that of `steps` steps ago."""
        delay(action, step, memory, self.steps)


def lag_shares(ratio: float) -> tuple[float, float]:
    """Return which shares of y − a a first-order lag leaves in the mean of y over a period, and at its end.

    y is the lagged action at the beginning of the period, a the action, and `ratio` the period over the time constant.
    """
    return float(-np.expm1(-ratio) / ratio), float(np.exp(-ratio))


@ACTUATORS.add
@settings
class MotorLag(ZeroInitialized):
    """A first-order lag T ẏ = a − y of each component.

    The action of a control period is the mean of y over this period, a + (y_k − a) (T/period) (1 − e^(−period/T)), with
    y_k at the beginning of the period. Its impulse (integral over the period) is therefore exact.
    """

    time_constant: Annotated[float, Range(1e-6, 1e6, "s")] = 0.05  # time constant T of the lag
    kind: Literal["motor_lag"] = "motor_lag"
    memory_size = ACTION_SIZE  # the lagged action

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Replace the action by the mean of the lagged action over the period."""
        mean, left = lag_shares(simulation.period / self.time_constant)
        gap = memory - action
        memory[:] = action + left * gap
        action += mean * gap


@ACTUATORS.add
@settings
class RateLimit(ZeroInitialized):
    """A limit on the rate of change of each component."""

    # largest change of an action in a second; from −1 to 1 takes 2/rate
    rate: Annotated[float, Range(1e-6, 1e9, "1/s")] = 20.0
    kind: Literal["rate_limit"] = "rate_limit"
    memory_size = ACTION_SIZE  # the previous action

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Move from the previous action towards the new one, as far as the rate limit allows."""
        max_change = self.rate * simulation.period
        memory += np.clip(action - memory, -max_change, max_change)
        action[:] = memory


@ACTUATORS.add
@settings
class PacketLoss(ZeroInitialized):
    """Random loss of commands; the last command that arrived replaces a lost one, at first hover."""

    probability: Annotated[float, Range(0.0, 1.0)] = 0.001  # probability that a command is lost
    kind: Literal["packet_loss"] = "packet_loss"
    memory_size = ACTION_SIZE  # the last action that arrived

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Replace lost commands by the last one that arrived."""
        hold(action, memory, streams.uniform(step + 1, 1)[:, 0] < self.probability)


@ACTUATORS.add
@settings
class PacketBursts(Interruptions):
    """Loss of all commands for a time, again and again; the last command that arrived replaces them, at first hover."""

    kind: Literal["packet_bursts"] = "packet_bursts"
    memory_size = Interruptions.memory_size + ACTION_SIZE  # the last action that arrived

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Replace lost commands by the last one that arrived."""
        hold(action, memory[:, 2:-1], self._held(memory, step, simulation.period, streams))


@ACTUATORS.add
@settings
class GyroBias:
    """A bias of the on-board gyro: the rate loop follows the commanded body rates minus the bias.

    The bias of each axis is normal, and drawn for each episode. The biased action stays in [−1, 1]. The simulation must
    have the command interface "body_rates".
    """

    deviation: Annotated[float, Range(0.0, 1000.0, "rad/s")] = 0.02  # standard deviation of the bias about each axis
    kind: Literal["gyro_bias"] = "gyro_bias"
    memory_size = 3  # the biases, rad/s

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the biases."""
        return self.deviation * streams.normal(0, 3)

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Subtract the bias from the commanded body rates."""
        for axis, limit in enumerate(simulation.command_scale[1:]):
            action[:, 1 + axis] = np.clip(action[:, 1 + axis] - memory[:, axis] / limit, -1.0, 1.0)


def check_chain(models: tuple[Any, ...], simulation: Simulation) -> None:
    """Refuse actuators that do not fit to the simulation."""
    if simulation.interface != "body_rates" and any(isinstance(model, GyroBias) for model in models):
        raise ValueError(f'GyroBias needs the interface "body_rates", not "{simulation.interface}"')
