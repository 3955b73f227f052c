"""The point-mass pendulum that moves like a body with a rigid pole, for the design of control laws.

A pole of the mass m and the inertia J about its centre of mass, at the distance l from the pivot, moves like a point
mass m' = m l/λ at the end of a massless rod of the length λ = l + J/(m l), with the mass m − m' in the pivot. So the
control laws take λ as rod length, m' as mass of the bob and M + m − m' as mass of the quadrotor.

A force d_B on the pole's centre of mass acts like d_B l/λ on the point mass and d_B (1 − l/λ) on the quadrotor.

The environment's reference F_d is that of the pole's centre of mass, ζ + l r. The flat output of the equivalent model
is ζ + λ r. Near hover F̈_λ = g r_xy and F_λ = F_d + (λ − l) r_xy, so

    (1)  F_λ = F_d + c F̈_λ = F_d + c F̈_d + c² F_d⁽⁴⁾ + …,          c = (λ − l)/g

The series ends with the highest derivative in the observation, order 6.

If the pivot is above the body's centre of mass by p_z, it accelerates with the attitude t of the thrust, by p_z ẗ. In
the coordinates

    (2)  s' = s + μ t,    t' = (1 + μ) t,    μ = M p_z/(M' λ),    M' = M + m − m'

the equations near hover are again those of a pendulum whose pivot is in the centre of mass,

    (3)  F̈' = g s'/(1 + μ),    s̈' = K (s' − t'),                       F' = F_λ + μ-terms of the same order as p_z

For the paper's vehicle all this changes nothing, and these functions return their arguments.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from quadpend_baselines.modelling import flat_outputs
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import BOB_FORCE, FORCE, State

_AXES = 3


@lru_cache(maxsize=64)
def design_parameters(simulation: Simulation) -> Parameters:
    """Return the parameters of the equivalent point-mass pendulum; those of the simulation without a rigid vehicle."""
    p = simulation.parameters
    if not simulation.is_rigid:
        return p
    length, mass = _equivalent_pole(simulation)
    return replace(p, quadrotor_mass=p.total_mass - mass, bob_mass=mass, rod_length=length)


def _equivalent_pole(simulation: Simulation) -> tuple[float, float]:
    """Return λ (m) and m' (kg)."""
    p, pole = simulation.parameters, simulation.rigid_vehicle.pole
    length = p.rod_length + pole.inertia / (p.bob_mass * p.rod_length)
    return length, p.bob_mass * p.rod_length / length


def design_disturbance(disturbance: Floats, simulation: Simulation) -> Floats:
    """Return the disturbance of the equivalent model, shape (n, 9), N and N·m.

    Args:
        disturbance: d_Q, d_B and d_τ, shape (n, 9), see `Disturbance`.
        simulation: The vehicle.
    """
    if not simulation.is_rigid:
        return disturbance
    out = disturbance.copy()
    share = simulation.parameters.rod_length / design_parameters(simulation).rod_length
    at_pole = disturbance[:, BOB_FORCE : BOB_FORCE + _AXES]
    out[:, BOB_FORCE : BOB_FORCE + _AXES] = share * at_pole
    out[:, FORCE : FORCE + _AXES] += (1.0 - share) * at_pole
    return out


def design_reference(reference: Floats, simulation: Simulation) -> Floats:
    """Return the derivatives of F_λ for those of F_d by equation (1); both of orders 2 … 6, shape (n, 5, 3)."""
    if not simulation.is_rigid:
        return reference
    c = (design_parameters(simulation).rod_length - simulation.parameters.rod_length) / simulation.parameters.gravity
    out = reference.copy()
    for power in (1, 2):
        out[:, : -2 * power, :2] += c**power * reference[:, 2 * power :, :2]
    return out


def nominal_trajectory(
    reference: Floats, yaw_reference: Floats, disturbance: Floats, simulation: Simulation
) -> tuple[Floats, Floats]:
    """Return the state and the command that follow a reference under a disturbance.

    Args:
        reference: F_d⁽ⁱ⁾ of (F_x, F_y, z) for i = 2 … 6, shape (n, 5, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s², shape (n, 3).
        disturbance: d_Q (N), d_B (N), d_τ (N·m), taken as constant, shape (n, 9).
        simulation: The vehicle.

    Returns:
        The state, shape (n, 18), with position and velocity relative to the reference, and thrust (N) and torques
        (N·m), shape (n, 4).
    """
    p, disturbance = design_parameters(simulation), design_disturbance(disturbance, simulation)
    trajectory = flat_outputs.flat_trajectory(design_reference(reference, simulation), disturbance, p)
    state, command = flat_outputs.state_and_command(trajectory, yaw_reference, disturbance, p)
    if simulation.is_rigid:
        s, length = State(state), simulation.parameters.rod_length
        s.position[:, :2], s.velocity[:, :2] = -length * s.direction[:, :2], -length * s.direction_rate[:, :2]
    return np.asarray(state), np.asarray(command)
