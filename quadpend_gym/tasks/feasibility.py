"""What a trajectory demands of the vehicle: thrust, tilt of the pendulum and of the body, and height.

Exact tracking in calm air, with the bob's horizontal position F and the quadrotor's height z (world frame):

    (1)  r = L/|L|,    L = (F̈_x, F̈_y, g + z̈)
    (2)  ṙ = (L̇ − n₁ r)/|L|,    n₁ = r·L̇
    (3)  r̈ = (L̈ − 2 n₁ ṙ − n₂ r)/|L|,    n₂ = ṙ·L̇ + r·L̈
    (4)  u b = (M + m_c)(F̈_x, F̈_y, g + z̈) + l (−M r̈_x, −M r̈_y, m_c r̈_z)

Equation (1) leaves out the vertical acceleration l r̈_z of the bob relative to the quadrotor, which is of second order
in the tilt and zero on circles; (2) to (4) follow from it exactly. The tilt of the body therefore has an error of third
order. Drag and the torques are not considered. A hanging pendulum has −r and −l in place of r and l.

| symbol | code name   | unit | frame | shape  |
|--------|-------------|------|-------|--------|
| r      | `direction` | 1    | world | (k, 3) |
| L      | `lift`      | m/s² | world | (k, 3) |
| u b    | `thrust`    | N    | world | (k, 3) |
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from gymnasium import logger

from quadpend_gym.core.arrays import Floats
from quadpend_gym.tasks.task import Limits
from quadpend_gym.tasks.trajectories import Sinusoids, Trajectory, Waypoints
from quadpend_gym.vehicles import Parameters, Simulation


class Demand(NamedTuple):
    """What exact tracking demands at k times."""

    thrust: Floats  # u, N, shape (k,)
    pendulum_angle: Floats  # angle of the pendulum from its side, rad, shape (k,)
    body_angle: Floats  # angle of the thrust axis from vertical, rad, shape (k,)
    height: Floats  # height of the lower of quadrotor and bob, m, shape (k,)


def demand(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float = 1.0) -> Demand:
    """Return what exact tracking in calm air demands at times of shape (k,), s, see (1) to (4) and `Task.side`."""
    p, rod_length = parameters, side * parameters.rod_length
    derivatives = trajectory.derivatives(times)[:, :, :3]
    lift, lift_rate, lift_acceleration = derivatives[:, 2] + [0.0, 0.0, p.gravity], derivatives[:, 3], derivatives[:, 4]
    size = np.linalg.norm(lift, axis=-1, keepdims=True)
    direction = lift / size
    first = _dot(direction, lift_rate)
    rate = (lift_rate - first * direction) / size
    second = _dot(rate, lift_rate) + _dot(direction, lift_acceleration)
    acceleration = (lift_acceleration - 2.0 * first * rate - second * direction) / size
    weights = rod_length * np.array([-p.quadrotor_mass, -p.quadrotor_mass, p.bob_mass])
    thrust = p.total_mass * lift + weights * acceleration
    size = np.linalg.norm(thrust, axis=-1)
    height = derivatives[:, 0, 2] + np.minimum(rod_length * direction[:, 2], 0.0)
    return Demand(size, np.arccos(direction[:, 2]), np.arccos(thrust[:, 2] / size), height)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.sum(a * b, axis=-1, keepdims=True))


@lru_cache(maxsize=64)
def check_feasible(trajectory: Trajectory, simulation: Simulation, limits: Limits, side: float = 1.0) -> None:
    """Refuse waypoints or sinusoids that need too much thrust or tilt, and warn if they exceed the termination limits.

    Later calls with equal arguments do nothing.
    """
    if not isinstance(trajectory, Waypoints | Sinusoids):
        return
    times = trajectory.sample_times()
    needed = demand(trajectory, simulation.parameters, times, side)
    warnings = []
    for what, angle, limit in (
        ("pendulum", needed.pendulum_angle, limits.pendulum_angle),
        ("body", needed.body_angle, limits.body_angle),
    ):
        at = int(angle.argmax())
        needs = f"needs a {what} tilt of {np.degrees(angle[at]):.1f}° at {times[at]:.2f} s"
        if angle[at] >= 0.5 * np.pi:
            raise ValueError(f"the trajectory cannot be flown: it {needs}, where it must be below 90°")
        if angle[at] > limit:
            warnings.append(f"the trajectory {needs}; episodes terminate at {np.degrees(limit):.1f}°")
    at, largest = int(needed.thrust.argmax()), 2.0 * float(simulation.command_scale[0])
    if needed.thrust[at] > largest:
        raise ValueError(
            f"the trajectory cannot be flown: it needs a thrust of {needed.thrust[at]:.2f} N at {times[at]:.2f} s, but"
            f" the largest is {largest:.2f} N"
        )
    at = int(needed.height.argmin())
    if needed.height[at] <= limits.ground:
        warnings.append(
            f"the trajectory reaches a height of {needed.height[at]:.2f} m at {times[at]:.2f} s; episodes terminate at"
            f" {limits.ground:.2f} m"
        )
    for warning in warnings:
        logger.warn(warning)
