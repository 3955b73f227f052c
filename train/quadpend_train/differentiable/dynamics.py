"""The equations of motion of the paper's vehicle and their integration in PyTorch, with gradients, for n rows.

The equations are those of `quadpend_gym.physics.dynamics`, (1) to (5), and of `quadpend_gym.physics.drag`, and the
integration is that of `quadpend_gym.physics.kernel`; these modules explain symbols, units and frames. In float64 the
results agree to 1e-12 (``tests/quadpend_train/differentiable/test_dynamics.py``).
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.physics.parameters import PARAMETERS_SIZE
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
    m, m_c, rod_length, gravity, ixx, iyy, izz, *areas = parameters.split([1] * PARAMETERS_SIZE, dim=1)
    return Physics(m, m_c, rod_length, gravity, torch.cat([ixx, iyy, izz], dim=1), *areas)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the dot product of each row, shape (n, 1)."""
    return (a * b).sum(dim=1, keepdim=True)


def thrust_axis(euler: Tensor) -> Tensor:
    """Return the thrust axis R e₃, equation (1), shape (n, 3)."""
    sin_roll, sin_pitch, sin_yaw = torch.sin(euler).unbind(dim=1)
    cos_roll, cos_pitch, cos_yaw = torch.cos(euler).unbind(dim=1)
    tilted = sin_pitch * cos_roll
    return torch.stack(
        [cos_yaw * tilted + sin_yaw * sin_roll, sin_yaw * tilted - cos_yaw * sin_roll, cos_pitch * cos_roll], dim=1
    )


def unconstrained_acceleration(force: Tensor, bob_force: Tensor, p: Physics) -> Tensor:
    """Return w, the acceleration of r without the force of the rod; `force` is F."""
    return (bob_force / p.bob_mass - force / p.quadrotor_mass) / p.rod_length


def direction_acceleration(r: Tensor, r_dot: Tensor, w: Tensor) -> Tensor:
    """Return r̈, equation (3)."""
    return w - (r * w + r_dot * r_dot).sum(dim=1, keepdim=True) * r


def centre_acceleration(force: Tensor, bob_force: Tensor, p: Physics) -> Tensor:
    """Return Ẍ, equation (4); `force` is F."""
    gravity = torch.cat([torch.zeros_like(p.gravity), torch.zeros_like(p.gravity), p.gravity], dim=1)
    return (force + bob_force) / (p.quadrotor_mass + p.bob_mass) - gravity


def drag(motion: Motion, air_velocity: Tensor, p: Physics) -> tuple[Tensor, Tensor]:
    """Return the drag of quadrotor and bob, equations (1) and (2) of `quadpend_gym.physics.drag`, N, shape (n, 3)."""
    relative = air_velocity - motion.velocity
    bob_relative = relative - p.rod_length * motion.direction_rate

    def force(area: Tensor, velocity: Tensor) -> Tensor:
        return 0.5 * AIR_DENSITY * area * torch.linalg.vector_norm(velocity, dim=1, keepdim=True) * velocity

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
    euler_ddot = (torque + forces.torque) / p.inertia  # equation (2)
    axis = thrust_axis(motion.euler)
    for _ in range(substeps):
        motion, axis = _substep(motion, axis, thrust, euler_ddot, forces, p, period / substeps)
    return motion


def _substep(
    motion: Motion, axis: Tensor, thrust: Tensor, euler_ddot: Tensor, forces: Forces, p: Physics, h: float
) -> tuple[Motion, Tensor]:
    """Advance by h; the suffixes 0, m and 1 mean the start, the middle and the end of the substep."""
    position, velocity, euler, euler_rate, r, v1 = motion
    bob_force = forces.bob_force

    def euler_at(time: float) -> Tensor:
        return euler + time * (euler_rate + 0.5 * time * euler_ddot)

    euler_end = euler_at(h)
    axis_end = thrust_axis(euler_end)
    force_0 = forces.force + thrust * axis
    force_m = forces.force + thrust * thrust_axis(euler_at(0.5 * h))
    force_1 = forces.force + thrust * axis_end

    w_0, w_m, w_1 = (unconstrained_acceleration(force, bob_force, p) for force in (force_0, force_m, force_1))
    a1 = direction_acceleration(r, v1, w_0)
    v2 = v1 + 0.5 * h * a1
    a2 = direction_acceleration(r + 0.5 * h * v1, v2, w_m)
    v3 = v1 + 0.5 * h * a2
    a3 = direction_acceleration(r + 0.5 * h * v2, v3, w_m)
    v4 = v1 + h * a3
    a4 = direction_acceleration(r + h * v3, v4, w_1)
    r_end = r + h / 6.0 * (v1 + v4 + 2.0 * (v2 + v3))
    v_end = v1 + h / 6.0 * (a1 + a4 + 2.0 * (a2 + a3))
    r_end = r_end / torch.linalg.vector_norm(r_end, dim=1, keepdim=True)
    v_end = v_end - dot(r_end, v_end) * r_end

    offset = p.bob_mass * p.rod_length / (p.quadrotor_mass + p.bob_mass)  # μ
    # Ẍ is an affine function of the force, so the means of Simpson's rule are those of the force.
    ddot_position = centre_acceleration((force_0 + 2.0 * force_m) / 3.0, bob_force, p)
    ddot_velocity = centre_acceleration((force_0 + 4.0 * force_m + force_1) / 6.0, bob_force, p)
    centre_rate = velocity + offset * v1
    centre = position + offset * r + h * centre_rate + 0.5 * h * h * ddot_position
    centre_rate = centre_rate + h * ddot_velocity
    end = Motion(
        centre - offset * r_end,
        centre_rate - offset * v_end,
        euler_end,
        euler_rate + h * euler_ddot,
        r_end,
        v_end,
    )
    return end, axis_end


def tensor(array: Any, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return a copy of an array as a tensor."""
    return torch.tensor(array, dtype=dtype)
