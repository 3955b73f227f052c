"""The point-mass pendulum that moves like a rigid body with a pole, for the design of control laws.

A pole of the mass m and the inertia J about its centre of mass, at the distance l from the pivot, moves like a point
mass m' = m l/λ at the end of a massless rod of the length λ = l + J/(m l), with the mass m − m' in the pivot. So the
control laws take λ as rod length, m' as mass of the bob and M' = M + m − m' as mass of the quadrotor. A force d_B on
the pole's centre of mass acts like d_B l/λ on the point mass and d_B (1 − l/λ) on the quadrotor.

A pivot at the height p above the body's centre of mass accelerates with the thrust tangent t by p ẗ. The equations near
hover are still those of a pendulum, with its flat output F:

    (1)  F̈ = g σ,    σ̈ = K (σ − t),        σ = (s + μ t)/(1 + μ),    μ = M p/((M + m) Λ),    Λ = M' λ/(M + m)
    (2)  F = ζ + l r + a s + b t,           b = (m p + M p/(1 + μ))/(M + m),    a = λ − l − M p/((M + m)(1 + μ))

s and t are the tangents of `flat_outputs`, in which σ takes the place of s. The reference F_d of the environment is
that of ζ + l r. By (1), s and t follow from derivatives of F, so by (2) the derivatives of the wanted F are

    (3)  F⁽ⁱ⁾ = F_d⁽ⁱ⁾ + c₂ F_d⁽ⁱ⁺²⁾ + (c₂² + c₄) F_d⁽ⁱ⁺⁴⁾ + …,    c₂ = (a + b)/g,    c₄ = (μ a − b)/(g K)

up to the highest derivative in the observation, order 6. For the paper's vehicle λ = l, m' = m and μ = a = b = 0.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from quadpend_baselines.modelling import flat_outputs
from quadpend_baselines.modelling.inverse_dynamics import body_torques
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import Disturbance, State
from quadpend_gym.vehicles import Drag, Pole, Vehicle


class EquivalentModel(NamedTuple):
    """The equivalent pendulum."""

    parameters: Parameters  # M', m' and λ; the other parameters are those of the vehicle
    pivot_share: float = 0.0  # μ/(1 + μ), share of t in σ
    pendulum_arm: float = 0.0  # a, m
    thrust_arm: float = 0.0  # b, m


@lru_cache(maxsize=64)
def equivalent_model(simulation: Simulation) -> EquivalentModel:
    """Return the equivalent pendulum of a simulation; the paper's vehicle is its own."""
    p = simulation.parameters
    if not simulation.is_rigid:
        return EquivalentModel(p)
    vehicle = simulation.vehicle
    length = p.rod_length + vehicle.pole.inertia / (p.bob_mass * p.rod_length)
    mass = p.bob_mass * p.rod_length / length
    height, share = vehicle.pivot[2], p.bob_mass / p.total_mass
    free = (1.0 - share) * height
    ratio = free / (length - share * p.rod_length)
    arm = free / (1.0 + ratio)
    return EquivalentModel(
        p._replace(quadrotor_mass=p.total_mass - mass, bob_mass=mass, rod_length=length),
        ratio / (1.0 + ratio),
        length - p.rod_length - arm,
        share * height + arm,
    )


def design_parameters(simulation: Simulation) -> Parameters:
    """Return M', m' and λ in place of M, m and l; without a rigid vehicle the parameters themselves."""
    return equivalent_model(simulation).parameters


@lru_cache(maxsize=64)
def design_simulation(simulation: Simulation) -> Simulation:
    """Return the equivalent pendulum with the paper's attitude model.

    Its torque limits, relative to K and the inertia, are those of the paper's vehicle, but at most those of the
    vehicle. They are the unit of effort of a controller; most rotors can make much larger torques.
    """
    if not simulation.is_rigid:
        return simulation
    p, (roll_pitch_limit, yaw_limit), paper = design_parameters(simulation), simulation.torque_limits, Simulation()
    paper_roll_pitch, paper_yaw = paper.torque_limits
    per_inertia = p.chain_stiffness / (paper.parameters.chain_stiffness * paper.parameters.inertia_roll)
    roll_pitch = per_inertia * paper_roll_pitch * 0.5 * (p.inertia_roll + p.inertia_pitch)
    yaw = per_inertia * paper_yaw * p.inertia_yaw
    vehicle = Vehicle(
        mass=p.quadrotor_mass,
        inertia=(p.inertia_roll, p.inertia_pitch, p.inertia_yaw),
        pole=Pole(p.bob_mass, p.rod_length, drag_area=p.bob_drag_area),
        attitude="euler",
        drag=Drag(p.quadrotor_drag_area),
        torque=(min(roll_pitch, roll_pitch_limit), min(yaw, yaw_limit)),
        gravity=p.gravity,
    )
    return replace(simulation, vehicle=vehicle, interface="wrench", latency=0.0)


def design_disturbance(disturbance: Floats, simulation: Simulation) -> Floats:
    """Return the disturbance that acts on the equivalent pendulum like a disturbance on the vehicle.

    Args:
        disturbance: d_Q, d_B and d_τ, N and N·m, shape (n, 9), see `Disturbance`.
        simulation: The vehicle.
    """
    if not simulation.is_rigid:
        return disturbance
    model, out = equivalent_model(simulation), Disturbance(disturbance.copy())
    p, share = model.parameters, simulation.parameters.rod_length / model.parameters.rod_length
    out.force[:] += (1.0 - share) * out.bob_force
    out.bob_force[:] *= share
    # Horizontally, the disturbance of s̈ acts on σ̈ with the factor 1/(1 + μ), and moves the equilibrium of σ.
    drift = (out.bob_force[:, :2] / p.bob_mass - out.force[:, :2] / p.quadrotor_mass) / p.rod_length
    out.bob_force[:, :2] -= p.bob_mass * p.gravity / p.chain_stiffness * model.pivot_share * drift
    wanted = (1.0 - model.pivot_share) * p.rod_length * drift
    out.force[:, :2] = p.quadrotor_mass * (out.bob_force[:, :2] / p.bob_mass - wanted)
    return out.array


def design_reference(reference: Floats, simulation: Simulation) -> Floats:
    """Return the derivatives of F for those of F_d by equation (3); both of orders 2 … 6, shape (n, 5, 3)."""
    if not simulation.is_rigid:
        return reference
    second, fourth = _series(simulation)
    out = reference.copy()
    out[:, :-2, :2] += second * reference[:, 2:, :2]
    out[:, :-4, :2] += fourth * reference[:, 4:, :2]
    return out


def reference_offset(reference: Floats, simulation: Simulation) -> Floats:
    """Return F − F_d of equation (3), the offset of the wanted F from the reference, m, shape (n, 2)."""
    second, fourth = _series(simulation)
    return np.asarray(second * reference[:, 0, :2] + fourth * reference[:, 2, :2])


def _series(simulation: Simulation) -> tuple[float, float]:
    """Return c₂ (s²) and c₂² + c₄ (s⁴) of equation (3)."""
    (p, share, pendulum_arm, thrust_arm) = equivalent_model(simulation)
    second = (pendulum_arm + thrust_arm) / p.gravity
    ratio = share / (1.0 - share)
    return second, second**2 + (ratio * pendulum_arm - thrust_arm) / (p.gravity * p.chain_stiffness)


def reference_trajectory(
    reference: Floats, yaw_reference: Floats, disturbance: Floats, simulation: Simulation
) -> tuple[Floats, Floats]:
    """Return the state and the command of the equivalent pendulum that follow a reference under a disturbance.

    Args:
        reference: F_d⁽ⁱ⁾ of (F_x, F_y, z) for i = 2 … 6, shape (n, 5, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s², shape (n, 3).
        disturbance: d_Q (N), d_B (N), d_τ (N·m), taken as constant, shape (n, 9).
        simulation: The vehicle.

    Returns:
        The state, shape (n, 18), with position and velocity relative to the reference, and thrust (N) and torques for
        the Euler angles (N·m), shape (n, 4); `body_command` converts them.
    """
    p, disturbance = design_parameters(simulation), design_disturbance(disturbance, simulation)
    trajectory = flat_outputs.flat_trajectory(design_reference(reference, simulation), disturbance, p)
    if simulation.is_rigid:
        share, tangent = equivalent_model(simulation).pivot_share, trajectory.pendulum_tangent[:3]
        pendulum = (tangent - share * trajectory.thrust_tangent) / (1.0 - share)
        vertical = flat_outputs.vertical_component(pendulum)
        trajectory = trajectory._replace(pendulum_tangent=pendulum, pendulum_vertical=vertical)
    state, command = flat_outputs.state_and_command(trajectory, yaw_reference, disturbance, p)
    s, length = State(state), simulation.parameters.rod_length
    s.position[:, :2], s.velocity[:, :2] = -length * s.direction[:, :2], -length * s.direction_rate[:, :2]
    return state, command


def body_command(state: Floats, command: Floats, disturbance: Floats, simulation: Simulation) -> Floats:
    """Return a command with torques about the body's axes for one with torques for the Euler angles.

    Without a rigid vehicle both are the same.

    Args:
        state: States, shape (n, 18).
        command: Thrust (N) and torques that accelerate the Euler angles η, I η̈ = τ + d_τ, shape (n, 4).
        disturbance: d_Q (N), d_B (N) and d_τ (N·m), shape (n, 9).
        simulation: The vehicle.
    """
    if not simulation.is_rigid:
        return command
    p = simulation.parameters
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    acceleration = (command[:, 1:] + Disturbance(disturbance).torque) / inertia
    torques = body_torques(state, acceleration, command[:, 0], disturbance, simulation)
    return np.column_stack([command[:, 0], torques])
