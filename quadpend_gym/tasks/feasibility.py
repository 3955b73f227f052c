"""What a trajectory demands of the vehicle: thrust, tilt of the pendulum and of the body, body rates and torques.

Exact tracking in calm air, with the bob's horizontal position F and the quadrotor's height z (world frame):

    (1)  r = L/|L|,    L = (F̈_x, F̈_y, g + z̈)
    (2)  ṙ = (L̇ − n₁ r)/|L|,    n₁ = r·L̇
    (3)  r̈ = (L̈ − 2 n₁ ṙ − n₂ r)/|L|,    n₂ = ṙ·L̇ + r·L̈
    (4)  u b = (M + m_c)(F̈_x, F̈_y, g + z̈) + l (−M r̈_x, −M r̈_y, m_c r̈_z)

Equation (1) leaves out the vertical acceleration l r̈_z of the bob relative to the quadrotor, which is of second order
in the tilt and zero on circles; (2) to (4) follow from it exactly. The tilt of the body therefore has an error of third
order. Drag is not considered. A hanging pendulum has −r and −l in place of r and l.

The thrust axis b and the yaw give the attitude R, and its central differences the body rate ω and ω̇. The torque also
carries the load of the pole at the pivot p:

    (5)  τ = I ω̇ + ω × I ω + p × Rᵀ (m_c L)

Thrust and torque give the thrusts f of the rotors, which must be within their limits, and so must their commands
f + T ḟ, with the lag T. A rate loop with the time constant T must be commanded ω + T ω̇.

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
from quadpend_gym.vehicles import Parameters, Simulation, mixing

_STEP = 1e-3  # s, of central differences


Check = tuple[Floats, float, str]  # values over time, limit, and a sentence for the largest value and its time


class Demand(NamedTuple):
    """What exact tracking demands at k times."""

    thrust: Floats  # u, N, shape (k,)
    pendulum_angle: Floats  # angle of the pendulum from its side, rad, shape (k,)
    body_angle: Floats  # angle of the thrust axis from vertical, rad, shape (k,)


def demand(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float = 1.0) -> Demand:
    """Return what exact tracking in calm air demands at times of shape (k,), s, see (1) to (4) and `Task.side`."""
    lift, thrust = _forces(trajectory, parameters, times, side)
    size = np.linalg.norm(thrust, axis=-1)
    pendulum = np.arccos(lift[:, 2] / np.linalg.norm(lift, axis=-1))
    return Demand(size, pendulum, np.arccos(thrust[:, 2] / size))


def _forces(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float) -> tuple[Floats, Floats]:
    """Return L (m/s²) and u b (N), shape (k, 3) each."""
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
    return lift, p.total_mass * lift + weights * acceleration


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.sum(a * b, axis=-1, keepdims=True))


def _attitude(trajectory: Trajectory, parameters: Parameters, times: Floats, side: float) -> Floats:
    """Return R, shape (k, 3, 3)."""
    thrust = _forces(trajectory, parameters, times, side)[1]
    z = thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
    yaw = trajectory.derivatives(times)[:, 0, 3]
    ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    x = ahead * z[:, 2:] - _dot(ahead, z) * [0.0, 0.0, 1.0]
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def turning(trajectory: Trajectory, simulation: Simulation, times: Floats, side: float = 1.0) -> tuple[Floats, ...]:
    """Return ω (rad/s), ω̇ (rad/s²) and τ (N·m) in the body frame, equation (5), shape (k, 3) each."""
    parameters, vehicle = simulation.vehicle.parameters, simulation.vehicle
    now, before, after = (_attitude(trajectory, parameters, times + h, side) for h in (0.0, -_STEP, _STEP))
    steps = [np.swapaxes(now, 1, 2) @ other for other in (before, after)]
    back, ahead = (0.5 * (m[:, [2, 0, 1], [1, 2, 0]] - m[:, [1, 2, 0], [2, 0, 1]]) for m in steps)
    rate, acceleration = (ahead - back) / (2.0 * _STEP), (ahead + back) / _STEP**2
    inertia = vehicle.inertia_matrix
    load = np.einsum("kji,kj->ki", now, vehicle.pole.mass * _forces(trajectory, parameters, times, side)[0])
    torque = acceleration @ inertia + np.cross(rate, rate @ inertia) + np.cross(vehicle.pivot, load)
    return rate, acceleration, torque


def _rotor_thrusts(trajectory: Trajectory, simulation: Simulation, times: Floats, side: float) -> Floats:
    """Return the thrusts of the rotors, N, shape (k, 4)."""
    thrust = demand(trajectory, simulation.vehicle.parameters, times, side).thrust
    wrench = np.column_stack([thrust, turning(trajectory, simulation, times, side)[2]])
    return np.asarray(wrench @ np.linalg.inv(mixing(simulation.vehicle)).T)


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
    _check(checks, times)
    _check(_turning_checks(trajectory, simulation, times, side), times)


def _turning_checks(trajectory: Trajectory, simulation: Simulation, times: Floats, side: float) -> list[Check]:
    """Return the torques, body rates and rotor thrusts that a trajectory with tilts below 90° demands, with limits."""
    vehicle, rotors = simulation.vehicle, simulation.vehicle.rotors
    rate, acceleration, torque = turning(trajectory, simulation, times, side)
    checks: list[Check] = []
    if simulation.interface == "body_rates":
        loop = vehicle.rate_loop
        command = np.abs(rate + loop.time_constant * acceleration)
        text = "a body rate command of {{:.3g}} rad/s about {} at {{:.2f}} s, but the largest is {:g} rad/s"
        checks += _by_axis(command, (loop.roll_pitch, loop.yaw), text)
    if rotors is None:
        text = "a torque of {{:.3g}} N·m about {} at {{:.2f}} s, but the largest is {:.3g} N·m"
        return checks + _by_axis(np.abs(torque), simulation.torque_limits, text)
    earlier, thrusts, later = (_rotor_thrusts(trajectory, simulation, times + h, side) for h in (-_STEP, 0.0, _STEP))
    slope = (later - earlier) / (2.0 * _STEP)
    commands = thrusts + np.where(slope > 0.0, *rotors.lags) * slope
    low, high = rotors.thrust
    beyond = np.maximum(commands - high, low - commands).max(axis=1)
    return [*checks, (beyond, 1e-9, f"{{:.3g}} N beyond {low:g} to {high:g} N of a rotor with its lag at {{:.2f}} s")]


def _by_axis(values: Floats, limits: tuple[float, float], text: str) -> list[Check]:
    axes = (values[:, :2].max(axis=1), limits[0], "roll or pitch"), (values[:, 2], limits[1], "yaw")
    return [(numbers, limit, text.format(axis, limit)) for numbers, limit, axis in axes]


def _check(checks: list[Check], times: Floats) -> None:
    """Refuse values that reach a limit."""
    for values, limit, what in checks:
        at = int(values.argmax())
        if values[at] >= limit:
            raise ValueError(f"the trajectory cannot be flown: it needs {what.format(values[at], times[at])}")
