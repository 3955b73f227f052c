"""Actuators: what becomes of an action before it moves the quadrotor.

An actuator changes the four numbers of an action, in the order in which they stand: ``[ActionDelay(2), MotorLag(0.05),
Rotors()]`` delays what the policy says, lets the motors lag, and mixes the rotors' thrusts. What comes out at the end
are thrust and torques, as in `QuadPendulumEnv`; the reward's effort is theirs.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.delays import check_steps, delay
from quadpend_gym.core.models import Model, Registry, Stateless, ZeroInitialized
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import check_number, check_positive, to_plain_fields
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.state import ACTION_SIZE


@runtime_checkable
class Actuator(Model, Protocol):
    """What an actuator model must be able to do, for a batch of n rows. No base class is needed."""

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Change the action that is held over the coming control period.

        Args:
            action: shape (n, 4), components in [−1, 1], columns contiguous, changed in place.
            memory: shape (n, memory_size), columns contiguous, updated in place.
            step: control steps since each row's episode began, shape (n,).
            simulation: period, parameters and limits, the nominal ones.
            streams: the rows' random streams; block `step + 1` belongs to this step.
        """


ACTUATORS = Registry("actuator", "an actuator model", Actuator)  # `registry` adds the kinds


class _FromHover(ZeroInitialized):
    """What remembers the present value of each component, hover at first."""

    @property
    def memory_size(self) -> int:
        """One number for each component."""
        return ACTION_SIZE


@dataclass(frozen=True)
class ActionDelay(ZeroInitialized):
    """A transport delay of whole control steps; until then, hover.

    Raises:
        ValueError: `steps` is not a whole number from 1 to 1000.
    """

    steps: int = 1
    kind: str = field(default="action_delay", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_steps(self.steps)

    @property
    def memory_size(self) -> int:
        """The actions of the last steps."""
        return self.steps * ACTION_SIZE

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """The action of `steps` steps ago."""
        delay(action, step, memory, self.steps)


@dataclass(frozen=True)
class MotorLag(_FromHover):
    """A first-order lag, T ẏ = a − y, of each component.

    Over a control period the mean of y acts, a + (y_k − a) (T/period) (1 − e^(−period/T)): the right impulse.

    Raises:
        TypeError: `time_constant` is not a number.
        ValueError: it is not finite or not above zero.
    """

    time_constant: float = 0.05  # s, T
    kind: str = field(default="motor_lag", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_positive(self.time_constant, "time_constant")

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """The mean of the lagging action over the period."""
        ratio = simulation.period / self.time_constant
        gap = memory - action
        memory[:] = action + np.exp(-ratio) * gap
        action += -np.expm1(-ratio) / ratio * gap


@dataclass(frozen=True)
class RateLimit(_FromHover):
    """No component of the action changes faster than `rate`.

    Raises:
        TypeError: `rate` is not a number.
        ValueError: it is not finite or not above zero.
    """

    rate: float = 20.0  # 1/s; from −1 to 1 in 2/rate
    kind: str = field(default="rate_limit", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_positive(self.rate, "rate")

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """The action as far as it can be reached from the one before."""
        reach = self.rate * simulation.period
        memory += np.clip(action - memory, -reach, reach)
        action[:] = memory


@dataclass(frozen=True)
class Rotors(Stateless):
    """The action is the thrust of four rotors, fᵢ = (M + m_c) g/4 · (1 + aᵢ): zero is hover, and none pulls down.

    The paper's mixing (its Section 2): u = f₁ + f₂ + f₃ + f₄,  τφ = (f₂ − f₄) d,  τθ = (f₃ − f₁) d, and the rotors'
    drag turns the body, τψ = κ (f₁ − f₂ + f₃ − f₄). The paper gives neither d nor κ.

    With Table 1's inertia, some thirty times a real one, such rotors turn the body with 7 rad/s² at most, too slowly to
    balance: the paper's controller falls from every start. Give the simulation a real inertia.

    Raises:
        TypeError: a value is not a number.
        ValueError: a value is not finite or not above zero.
    """

    arm: float = 0.2  # m, d, from the centre to each rotor
    drag_ratio: float = 0.02  # m, κ, drag torque per thrust
    kind: str = field(default="rotors", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_positive(self.arm, "arm")
        check_positive(self.drag_ratio, "drag_ratio")

    def mixing(self, simulation: Simulation) -> Floats:
        """The matrix from the rotors' numbers to those of thrust and torques, shape (4, 4).

        Raises:
            ValueError: the rotors can turn harder than the simulation's actuators.
        """
        d, k = self.arm, self.drag_ratio
        forces = simulation.parameters.hover_thrust / 4.0
        rows = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, d, 0.0, -d], [-d, 0.0, d, 0.0], [k, -k, k, -k]])
        mixing = forces * rows / simulation.command_scale[:, np.newaxis]
        strongest = np.abs(mixing).sum(axis=1)
        if (strongest > 1.0 + 1e-12).any():
            row = int(strongest.argmax())
            name, unit = ("thrust", "N") if row == 0 else ("torque", "N·m")
            limit = simulation.command_scale[row]
            raise ValueError(
                f"the rotors' {name} of up to {limit * strongest[row]:g} {unit} passes the simulation's limit of"
                f" {limit:g} {unit}: give them less arm or drag_ratio, or raise the limit"
            )
        return np.asarray(mixing)

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """Thrust and torques of the four rotors."""
        f1, f2, f3, f4 = action.T.copy()
        for column, (m1, m2, m3, m4) in enumerate(_mixing(self, simulation)):
            action[:, column] = np.clip(m1 * f1 + m2 * f2 + m3 * f3 + m4 * f4, -1.0, 1.0)  # but for rounding, inside


@lru_cache(maxsize=64)
def _mixing(rotors: Rotors, simulation: Simulation) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in rotors.mixing(simulation).tolist())


@dataclass(frozen=True)
class RotorFault(Stateless):
    """One rotor gives only a part of its thrust, from some time on; the `Rotors` must stand behind it.

    Raises:
        TypeError: a value is not a number.
        ValueError: there is no such rotor, or a value is out of range.
    """

    rotor: int = 1  # 1 to 4
    effectiveness: float = 0.7  # what is left of the thrust, 0 to 1
    onset: float = 0.0  # s
    kind: str = field(default="rotor_fault", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        if not isinstance(self.rotor, int) or isinstance(self.rotor, bool) or not 1 <= self.rotor <= 4:
            raise ValueError(f"rotor must be 1, 2, 3 or 4, not {self.rotor!r}")
        check_number(self.effectiveness, "effectiveness", 0.0, 1.0)
        check_number(self.onset, "onset", 0.0)

    def act(self, action: Floats, memory: Floats, step: Integers, simulation: Simulation, streams: Streams) -> None:
        """The weak rotor's thrust."""
        weak = self.effectiveness * (1.0 + action[:, self.rotor - 1]) - 1.0
        begun = step * simulation.period >= self.onset
        action[:, self.rotor - 1] = np.where(begun, weak, action[:, self.rotor - 1])
