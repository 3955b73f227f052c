"""What a trajectory demands of the vehicle: thrust, and tilt of the pendulum and of the body.

Exact tracking in calm air, with the bob's horizontal position F and the quadrotor's height z (world frame):

    (1)  r = L/|L|,    L = (F̈_x, F̈_y, g + z̈)
    (2)  ṙ = (L̇ − n₁ r)/|L|,    n₁ = r·L̇
    (3)  r̈ = (L̈ − 2 n₁ ṙ − n₂ r)/|L|,    n₂ = ṙ·L̇ + r·L̈
    (4)  u b = (M + m_c)(F̈_x, F̈_y, g + z̈) + l (−M r̈_x, −M r̈_y, m_c r̈_z)

Equation (1) leaves out the vertical acceleration l r̈_z of the bob relative to the quadrotor, which is of second order
in the tilt and zero on circles; (2) to (4) follow from it exactly. The tilt of the body therefore has an error of third
order. Drag and torques are not considered. A hanging pendulum has −r and −l in place of r and l.

| symbol | code name   | unit | frame | shape  |
|--------|-------------|------|-------|--------|
| r      | `direction` | 1    | world | (k, 3) |
| L      | `lift`      | m/s² | world | (k, 3) |
| u b    | `thrust`    | N    | world | (k, 3) |
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.tasks.trajectories import Trajectory
from quadpend_gym.vehicles import Parameters, Simulation

_LEAST = 1e-9  # m/s² and N; without L or thrust the tilt counts as 90°


class Demand(NamedTuple):
    """What exact tracking demands at k times."""

    thrust: Floats  # u, N, shape (k,)
    pendulum_angle: Floats  # angle of the pendulum from its side, rad, shape (k,)
    body_angle: Floats  # angle of the thrust axis from vertical, rad, shape (k,)


def demand(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float = 1.0) -> Demand:
    """Return what exact tracking in calm air demands at times of shape (k,), s, see (1) to (4) and `Task.side`."""
    lift, thrust = _forces(trajectory, parameters, times, side)
    return Demand(np.linalg.norm(thrust, axis=-1), _tilt(lift), _tilt(thrust))


def _tilt(vector: Floats) -> Floats:
    return np.asarray(np.arccos(vector[:, 2] / np.maximum(np.linalg.norm(vector, axis=-1), _LEAST)))


def _forces(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float) -> tuple[Floats, Floats]:
    """Return L (m/s²) and u b (N), shape (k, 3) each."""
    p, rod_length = parameters, side * parameters.rod_length
    derivatives = trajectory.derivatives(times)[:, :, :3]
    lift, lift_rate, lift_acceleration = derivatives[:, 2] + [0.0, 0.0, p.gravity], derivatives[:, 3], derivatives[:, 4]
    size = np.maximum(np.linalg.norm(lift, axis=-1, keepdims=True), _LEAST)
    direction = lift / size
    first = _dot(direction, lift_rate)
    rate = (lift_rate - first * direction) / size
    second = _dot(rate, lift_rate) + _dot(direction, lift_acceleration)
    acceleration = (lift_acceleration - 2.0 * first * rate - second * direction) / size
    weights = rod_length * np.array([-p.quadrotor_mass, -p.quadrotor_mass, p.bob_mass])
    return lift, p.total_mass * lift + weights * acceleration


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.sum(a * b, axis=-1, keepdims=True))


@lru_cache(maxsize=64)
def check_feasible(trajectory: Trajectory, simulation: Simulation, side: float = 1.0) -> None:
    """Refuse a trajectory that the vehicle cannot fly; later calls with equal arguments do nothing."""
    times = trajectory.sample_times()
    needed = demand(trajectory, simulation.parameters, times, side)
    largest = 2.0 * float(simulation.command_scale[0])
    checks = [
        (np.degrees(needed.pendulum_angle), 90.0, "a pendulum tilt of {:.1f}° at {:.2f} s, where it must be below 90°"),
        (np.degrees(needed.body_angle), 90.0, "a body tilt of {:.1f}° at {:.2f} s, where it must be below 90°"),
        (needed.thrust, largest, f"a thrust of {{:.2f}} N at {{:.2f}} s, but the largest is {largest:.2f} N"),
    ]
    for values, limit, what in checks:
        at = int(values.argmax())
        if values[at] >= limit:
            raise ValueError(f"the trajectory cannot be flown: it needs {what.format(values[at], times[at])}")
