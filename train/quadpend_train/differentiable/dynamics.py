"""The equations of motion of the paper's vehicle and their integration in PyTorch, with gradients, for n rows.

The equations are those of `quadpend_gym.physics.dynamics`, (1) to (5), and of `quadpend_gym.physics.drag`, and the
integration is that of `quadpend_gym.physics.euler_kernel`; these modules explain symbols, units and frames. In float64
the results agree to 1e-12 (``tests/quadpend_train/differentiable/test_plant.py``).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.physics.state import STATE_FIELDS


class Motion(NamedTuple):
    """The state of n rows, see `quadpend_gym.physics.state`; each field has the shape (n, 3)."""

    position: Tensor
    velocity: Tensor
    euler: Tensor
    euler_rate: Tensor
    direction: Tensor
    direction_rate: Tensor


class Forces(NamedTuple):
    """The disturbance of n rows, see `quadpend_gym.physics.state`; each field has the shape (n, 3)."""

    force: Tensor
    bob_force: Tensor
    torque: Tensor


class Physics(NamedTuple):
    """The parameters of n rows, see `Parameters`; each field has the shape (n, 1), the inertia (n, 3)."""

    quadrotor_mass: Tensor
    bob_mass: Tensor
    rod_length: Tensor
    gravity: Tensor
    inertia: Tensor
    quadrotor_drag_area: Tensor
    bob_drag_area: Tensor


def as_motion(state: Tensor) -> Motion:
    """Return the parts of states, shape (n, 18)."""
    return Motion(*(state[:, part] for part in STATE_FIELDS.values()))


def as_state(motion: Motion) -> Tensor:
    """Return states, shape (n, 18), from their parts."""
    return torch.cat(motion, dim=1)


def as_physics(parameters: Tensor) -> Physics:
    """Return the parameters in an array with the order of `Parameters.as_array`, shape (n, 9)."""
    m, m_c, rod_length, gravity, ixx, iyy, izz, *areas = torch.split(parameters, 1, dim=1)
    return Physics(m, m_c, rod_length, gravity, torch.cat([ixx, iyy, izz], dim=1), *areas)


def axpy(factor: float, a: Tensor, b: Tensor) -> Tensor:
    """Return factor · a + b."""
    return torch.add(b, a, alpha=factor)


def thrust_axis(euler: Tensor) -> Tensor:
    """Return the thrust axis R e₃, equation (1), shape (..., 3)."""
    sin_roll, sin_pitch, sin_yaw = torch.sin(euler).unbind(dim=-1)
    cos_roll, cos_pitch, cos_yaw = torch.cos(euler).unbind(dim=-1)
    tilted = sin_pitch * cos_roll
    return torch.stack(
        [cos_yaw * tilted + sin_yaw * sin_roll, sin_yaw * tilted - cos_yaw * sin_roll, cos_pitch * cos_roll], dim=-1
    )


def unconstrained_acceleration(force: Tensor, bob_force: Tensor, p: Physics) -> Tensor:
    """Return w, the acceleration of r without the force of the rod; `force` is F."""
    return bob_force / (p.bob_mass * p.rod_length) - force / (p.quadrotor_mass * p.rod_length)


def direction_acceleration(r: Tensor, r_dot: Tensor, w: Tensor) -> Tensor:
    """Return r̈, equation (3)."""
    along = torch.addcmul(r_dot * r_dot, r, w).sum(dim=1, keepdim=True)
    return torch.addcmul(w, along, r, value=-1.0)


def centre_acceleration(force: Tensor, bob_force: Tensor, p: Physics) -> Tensor:
    """Return Ẍ, equation (4); `force` is F."""
    gravity = p.gravity * p.gravity.new_tensor([0.0, 0.0, 1.0])
    return (force + bob_force) / (p.quadrotor_mass + p.bob_mass) - gravity


def drag(motion: Motion, air_velocity: Tensor, p: Physics) -> tuple[Tensor, Tensor]:
    """Return the drag of quadrotor and bob, equations (1) and (2) of `quadpend_gym.physics.drag`, N, shape (n, 3)."""
    relative = air_velocity - motion.velocity
    bob_relative = relative - p.rod_length * motion.direction_rate

    def force(area: Tensor, velocity: Tensor) -> Tensor:
        speed: Tensor = torch.linalg.vector_norm(velocity, dim=1, keepdim=True)
        return 0.5 * AIR_DENSITY * area * speed * velocity

    return force(p.quadrotor_drag_area, relative), force(p.bob_drag_area, bob_relative)


def advance(motion: Motion, command: Tensor, forces: Forces, p: Physics, period: float, substeps: int) -> Motion:
    """Return the motion one period later, during which commands and disturbances are constant.

    Args:
        motion: The motion at the beginning of the period.
        command: Thrust u (N) and torques τφ, τθ, τψ (N·m), shape (n, 4).
        forces: The disturbance.
        p: Physical parameters.
        period: Length of the period, s.
        substeps: Number of Runge–Kutta steps in the period.
    """
    thrust, torque = command[:, :1], command[:, 1:]
    bob_force = forces.bob_force
    h = period / substeps
    # All times at which Runge–Kutta evaluates the forces: start, middle and end of each substep, shape (k, 1, 1)
    times = torch.arange(2 * substeps + 1, dtype=command.dtype)[:, None, None] * (0.5 * h)
    euler_ddot = (torque + forces.torque) / p.inertia  # equation (2)
    euler = motion.euler + times * (motion.euler_rate + 0.5 * times * euler_ddot)
    force = forces.force + thrust * thrust_axis(euler)  # F, shape (k, n, 3), as w and Ẍ
    w, centre_ddot = unconstrained_acceleration(force, bob_force, p), centre_acceleration(force, bob_force, p)

    r, r_dot = motion.direction, motion.direction_rate
    for w_0, w_m, w_1 in zip(w[:-1:2], w[1::2], w[2::2], strict=True):
        r, r_dot = _substep(r, r_dot, w_0, w_m, w_1, h)

    offset = p.bob_mass * p.rod_length / (p.quadrotor_mass + p.bob_mass)  # μ
    centre_rate = motion.velocity + offset * motion.direction_rate
    to_position, to_velocity = _quadrature(period, substeps)
    return Motion(
        motion.position
        + offset * (motion.direction - r)
        + period * centre_rate
        + torch.tensordot(centre_ddot.new_tensor(to_position), centre_ddot, dims=1),
        centre_rate - offset * r_dot + torch.tensordot(centre_ddot.new_tensor(to_velocity), centre_ddot, dims=1),
        euler[-1],
        axpy(period, euler_ddot, motion.euler_rate),
        r,
        r_dot,
    )


def _substep(r: Tensor, v1: Tensor, w_0: Tensor, w_m: Tensor, w_1: Tensor, h: float) -> tuple[Tensor, Tensor]:
    """Return r and ṙ after h; the suffixes 0, m and 1 mean the start, the middle and the end of the substep."""
    a1 = direction_acceleration(r, v1, w_0)
    v2 = axpy(0.5 * h, a1, v1)
    a2 = direction_acceleration(axpy(0.5 * h, v1, r), v2, w_m)
    v3 = axpy(0.5 * h, a2, v1)
    a3 = direction_acceleration(axpy(0.5 * h, v2, r), v3, w_m)
    v4 = axpy(h, a3, v1)
    a4 = direction_acceleration(axpy(h, v3, r), v4, w_1)
    r_end = axpy(h / 6.0, axpy(2.0, v2 + v3, v1 + v4), r)
    v_end = axpy(h / 6.0, axpy(2.0, a2 + a3, a1 + a4), v1)
    r_end = r_end / torch.linalg.vector_norm(r_end, dim=1, keepdim=True)
    along = (r_end * v_end).sum(dim=1, keepdim=True)
    return r_end, torch.addcmul(v_end, along, r_end, value=-1.0)


@lru_cache(maxsize=32)
def _quadrature(period: float, substeps: int) -> tuple[list[float], list[float]]:
    """Return the weights with which Simpson's rule integrates Ẍ twice, to the position, and once, to the velocity."""
    h, size = period / substeps, 2 * substeps + 1
    position, velocity = np.zeros(size), np.zeros(size)
    for first in range(0, size - 1, 2):
        position += h * velocity
        position[first : first + 2] += h * h / 6.0 * np.array([1.0, 2.0])
        velocity[first : first + 3] += h / 6.0 * np.array([1.0, 4.0, 1.0])
    return position.tolist(), velocity.tolist()


def tensor(array: Any, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return a copy of an array as a tensor."""
    return torch.tensor(array, dtype=dtype)
