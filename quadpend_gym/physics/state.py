"""Layout of the state, disturbance and command arrays.

World frame: z up. Body frame: the rotation R = Rz(ψ) Ry(θ) Rx(φ) maps body vectors to world vectors.

The state has 18 components (`State`):

| symbol | name           | fields | unit  | frame                          |
|--------|----------------|--------|-------|--------------------------------|
| ζ      | position       | 0–2    | m     | world, quadrotor's centre      |
| ζ̇      | velocity       | 3–5    | m/s   | world                          |
| η      | euler          | 6–8    | rad   | roll φ, pitch θ, yaw ψ         |
| η̇      | euler_rate     | 9–11   | rad/s | φ̇, θ̇, ψ̇                        |
| r      | direction      | 12–14  | 1     | world, unit, pivot to bob      |
| ṙ      | direction_rate | 15–17  | 1/s   | world, perpendicular to r      |

The disturbance has 9 components (`Disturbance`):

| symbol | name      | fields | unit | frame                    |
|--------|-----------|--------|------|--------------------------|
| d_Q    | force     | 0–2    | N    | world, on the quadrotor  |
| d_B    | bob_force | 3–5    | N    | world, on the bob        |
| d_τ    | torque    | 6–8    | N·m  | world, or φ, θ, ψ axes   |

The torque d_τ on a rigid vehicle is a vector of the world frame. The paper's attitude model has no such vector: there
d_τ, as the torques of the command, acts about the axes of φ, θ and ψ, whichever way the vehicle is turned.

The command has 4 components: the thrust u (N) and the torques (N·m), about the body's axes on a rigid vehicle.

`State` computes the paper's spherical angles (α, β) from r: r = (sin α cos β, sin α sin β, cos α). They cannot be state
variables: in these coordinates the mass matrix is singular at α = 0, which is the upright equilibrium.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats

STATE_SIZE, DISTURBANCE_SIZE, COMMAND_SIZE, ACTION_SIZE = 18, 9, 4, 4
# Index of the first component of each vector in the arrays, as constants that compiled functions can read.
POSITION, VELOCITY, EULER, EULER_RATE, DIRECTION, DIRECTION_RATE = 0, 3, 6, 9, 12, 15
FORCE, BOB_FORCE, TORQUE = 0, 3, 6
THRUST, COMMAND_TORQUE = 0, 1


class _Vector:
    """A vector in an array, as a view of shape (..., 3); writing into it writes into the array."""

    def __init__(self, first: int) -> None:
        self.part = slice(first, first + 3)

    def __get__(self, instance: Any, owner: type) -> Floats:
        view: Floats = instance.array[..., self.part]
        return view


@dataclass(frozen=True)
class State:
    """Named views of a state array, with the units and frames of the module's table.

    Attributes:
        array: shape (..., 18), float64.
    """

    array: Floats
    position = _Vector(POSITION)
    velocity = _Vector(VELOCITY)
    euler = _Vector(EULER)
    euler_rate = _Vector(EULER_RATE)
    direction = _Vector(DIRECTION)
    direction_rate = _Vector(DIRECTION_RATE)

    @property
    def alpha(self) -> Floats:
        """Angle α of the pendulum from upright, rad in [0, π], shape (...)."""
        x, y, z = np.moveaxis(self.direction, -1, 0)
        return np.asarray(np.arctan2(np.hypot(x, y), z))

    @property
    def beta(self) -> Floats:
        """Azimuth β of the pendulum, rad in (−π, π], shape (...); undefined at α = 0."""
        return np.asarray(np.arctan2(self.direction[..., 1], self.direction[..., 0]))


@dataclass(frozen=True)
class Disturbance:
    """Named views of a disturbance array, with the units and frames of the module's table.

    Attributes:
        array: shape (..., 9), float64.
    """

    array: Floats
    force = _Vector(FORCE)
    bob_force = _Vector(BOB_FORCE)
    torque = _Vector(TORQUE)


def _fields(kind: type) -> dict[str, slice]:
    return {name: value.part for name, value in vars(kind).items() if isinstance(value, _Vector)}


STATE_FIELDS = _fields(State)
