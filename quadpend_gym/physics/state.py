"""Layout of the state, 18 numbers.

World frame: z up. Body frame: R = Rz(ψ) Ry(θ) Rx(φ) takes body vectors to the world.

| symbol | name           | fields | unit  | frame                          |
|--------|----------------|--------|-------|--------------------------------|
| ζ      | position       | 0–2    | m     | world, quadrotor's centre      |
| ζ̇      | velocity       | 3–5    | m/s   | world                          |
| η      | euler          | 6–8    | rad   | roll φ, pitch θ, yaw ψ         |
| η̇      | euler_rate     | 9–11   | rad/s |                                |
| r      | direction      | 12–14  | 1     | world, unit, pivot to bob      |
| ṙ      | direction_rate | 15–17  | 1/s   | world, perpendicular to r      |

The paper's spherical angles (α, β) are views of r: r = (sin α cos β, sin α sin β, cos α). They cannot be states: the
mass matrix in these coordinates is singular at α = 0, which is where the pendulum is meant to stand.
"""

from dataclasses import dataclass

import numpy as np

from quadpend_gym.core.arrays import Floats

STATE_SIZE = 18
DISTURBANCE_SIZE, COMMAND_SIZE, ACTION_SIZE = 9, 4, 4
POSITION, VELOCITY, EULER, EULER_RATE, DIRECTION, DIRECTION_RATE = 0, 3, 6, 9, 12, 15
STATE_FIELDS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "euler": slice(6, 9),
    "euler_rate": slice(9, 12),
    "direction": slice(12, 15),
    "direction_rate": slice(15, 18),
}


@dataclass(frozen=True)
class State:
    """Named views of a state array; writing into a view writes into the array.

    Attributes:
        array: shape (..., 18), float64.
    """

    array: Floats

    @property
    def position(self) -> Floats:
        """Quadrotor's centre ζ in the world frame, m, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["position"]]

    @property
    def velocity(self) -> Floats:
        """Its velocity ζ̇, m/s, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["velocity"]]

    @property
    def euler(self) -> Floats:
        """Roll φ, pitch θ, yaw ψ, rad, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["euler"]]

    @property
    def euler_rate(self) -> Floats:
        """φ̇, θ̇, ψ̇, rad/s, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["euler_rate"]]

    @property
    def direction(self) -> Floats:
        """Unit vector r from the pivot to the bob in the world frame, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["direction"]]

    @property
    def direction_rate(self) -> Floats:
        """Its rate ṙ, 1/s, shape (..., 3)."""
        return self.array[..., STATE_FIELDS["direction_rate"]]

    @property
    def alpha(self) -> Floats:
        """Angle α of the pendulum from upright, rad in [0, π], shape (...)."""
        x, y, z = np.moveaxis(self.direction, -1, 0)
        return np.asarray(np.arctan2(np.hypot(x, y), z))

    @property
    def beta(self) -> Floats:
        """Azimuth β of the pendulum, rad in (−π, π], shape (...); meaningless at α = 0."""
        return np.asarray(np.arctan2(self.direction[..., 1], self.direction[..., 0]))

    @property
    def alpha_x(self) -> Floats:
        """Angle of the pendulum's projection on the x–z plane from upright, rad, shape (...)."""
        return np.asarray(np.arctan2(self.direction[..., 0], self.direction[..., 2]))

    @property
    def alpha_y(self) -> Floats:
        """Angle of the pendulum's projection on the y–z plane from upright, rad, shape (...)."""
        return np.asarray(np.arctan2(self.direction[..., 1], self.direction[..., 2]))
