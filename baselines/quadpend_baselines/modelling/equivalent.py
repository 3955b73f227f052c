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

`equivalent_model` returns the model of a vehicle: `EquivalentModel` for the paper's, `RigidEquivalentModel` for others.
"""

from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np

from quadpend_baselines.modelling import flat_outputs, taylor
from quadpend_baselines.modelling.inverse_dynamics import body_torques
from quadpend_baselines.modelling.planar import rotate
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import RigidPlant, plant_of
from quadpend_gym.physics.state import Disturbance, State
from quadpend_gym.vehicles import Drag, Pole, Vehicle

_LEAST_VERTICAL = 0.1  # lower bound of r_z and b_z in tangents
_MAX_ANGLE = 1.4  # rad, limit of roll and pitch in tangents


class EquivalentModel:
    """The equivalent pendulum of the paper's vehicle: the vehicle itself, with r_xy and the tilt n for s and t.

    Args:
        simulation: The vehicle.
    """

    parameters: Parameters  # M', m' and λ; the others are those of the vehicle
    pivot_share = 0.0  # μ/(1 + μ), the share of t in σ
    pendulum_arm = 0.0  # a, m
    thrust_arm = 0.0  # b, m

    def __init__(self, simulation: Simulation) -> None:
        self.vehicle = simulation
        self.parameters = simulation.parameters

    @cached_property
    def simulation(self) -> Simulation:
        """The equivalent pendulum with the paper's attitude model."""
        return self.vehicle

    def sigma(self, pendulum: Floats, tilt: Floats) -> Floats:
        """Return σ, or its rate, for s and t or their rates, shape (n, 2)."""
        return pendulum + self.pivot_share * (tilt - pendulum)

    def pendulum(self, sigma: Floats, tilt: Floats) -> Floats:
        """Return s for σ and t: the inverse of `sigma`."""
        return (sigma - self.pivot_share * tilt) / (1.0 - self.pivot_share)

    def disturbance(self, disturbance: Floats) -> Floats:
        """Return d_Q, d_B and d_τ (N, N·m) that act on the equivalent pendulum like those on the vehicle, (n, 9)."""
        return disturbance

    def reference(self, reference: Floats) -> Floats:
        """Return the derivatives of F for those of F_d by equation (3); both of orders 2 … 6, shape (n, 5, 3)."""
        return reference

    def reference_offset(self, reference: Floats) -> Floats | float:
        """Return F − F_d of equation (3), the offset of the wanted F from the reference, m, shape (n, 2)."""
        return 0.0

    def trajectory(self, reference: Floats, yaw_reference: Floats, disturbance: Floats) -> tuple[Floats, Floats]:
        """Return the state and the command of the equivalent pendulum that follow a reference under a disturbance.

        Args:
            reference: F_d⁽ⁱ⁾ of (F_x, F_y, z) for i = 2 … 6, shape (n, 5, 3).
            yaw_reference: ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s², shape (n, 3).
            disturbance: d_Q (N), d_B (N), d_τ (N·m), taken as constant, shape (n, 9).

        Returns:
            The state, shape (n, 18), with position and velocity relative to the reference, and thrust (N) and torques
            for the Euler angles (N·m), shape (n, 4); `body_command` converts them.
        """
        p, disturbance = self.parameters, self.disturbance(disturbance)
        trajectory = self._of_pole(flat_outputs.flat_trajectory(self.reference(reference), disturbance, p))
        state, command = flat_outputs.state_and_command(trajectory, yaw_reference, disturbance, p)
        s, length = State(state), self.vehicle.parameters.rod_length
        s.position[:, :2], s.velocity[:, :2] = -length * s.direction[:, :2], -length * s.direction_rate[:, :2]
        return state, command

    def _of_pole(self, trajectory: flat_outputs.FlatTrajectory) -> flat_outputs.FlatTrajectory:
        """Return the trajectory with s in place of σ."""
        return trajectory

    def body_command(self, state: Floats, command: Floats, disturbance: Floats) -> Floats:
        """Return a command with torques about the body's axes for one with torques for the Euler angles, shape (n, 4).

        The latter has thrust (N) and torques that accelerate the Euler angles η in the disturbance, I η̈ = τ + d_τ.
        """
        return command

    def tangents(self, direction: Floats, tilt: Floats, thrust_axis: Floats) -> tuple[Floats, Floats]:
        """Return s and t, shape (n, 2), for r and b, shape (n, 3), and the tilt n, rad, shape (n, 2)."""
        return direction[:, :2], tilt

    def pendulum_rate(self, direction: Floats, direction_rate: Floats, pendulum: Floats) -> Floats:
        """Return ṡ for r, ṙ and s, rad/s, shape (n, 2)."""
        return direction_rate[:, :2]

    def direction_rate(self, direction: Floats, pendulum_rate: Floats) -> Floats:
        """Return the horizontal ṙ for r and ṡ, 1/s, shape (n, 2)."""
        return pendulum_rate

    def tilt_rate(self, state: Floats, yaw: Floats) -> Floats:
        """Return ṫ for states, shape (n, 18), and ψ, shape (n,), in rad/s, shape (n, 2)."""
        return rotate(State(state).euler_rate[:, [1, 0]] * [1.0, -1.0], yaw, 0)

    def angular_accelerations(self, before: Floats, after: Floats, period: float) -> Floats:
        """Return the mean accelerations of tilt and yaw between two states, as φ, θ and ψ near hover, (n, 3)."""
        return (State(after).euler_rate - State(before).euler_rate) / period

    def euler_accelerations(self, state: Floats, acceleration: Floats) -> Floats:
        """Return the accelerations of the Euler angles that make those of tilt and yaw, rad/s², shape (n, 3).

        The latter are ẗ in the axes of the heading, as accelerations of φ and θ near hover, and ψ̈.
        """
        return acceleration


class RigidEquivalentModel(EquivalentModel):
    """The equivalent pendulum of a rigid body with a pole; s and t are tangents."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        p, vehicle = simulation.parameters, simulation.vehicle
        length = p.rod_length + vehicle.pole.inertia / (p.bob_mass * p.rod_length)
        mass = p.bob_mass * p.rod_length / length
        height, share = vehicle.pivot[2], p.bob_mass / p.total_mass
        free = (1.0 - share) * height
        ratio = free / (length - share * p.rod_length)
        arm = free / (1.0 + ratio)
        self.parameters = p._replace(quadrotor_mass=p.total_mass - mass, bob_mass=mass, rod_length=length)
        self.pivot_share = ratio / (1.0 + ratio)
        self.pendulum_arm = length - p.rod_length - arm
        self.thrust_arm = share * height + arm

    @cached_property
    def simulation(self) -> Simulation:
        """The equivalent pendulum with the paper's attitude model.

        Its torque limits, relative to K and the inertia, are those of the paper's vehicle, but at most those of the
        vehicle. They are the unit of effort of a controller; most rotors can make much larger torques.
        """
        p, (roll_pitch_limit, yaw_limit), paper = self.parameters, self.vehicle.torque_limits, Simulation()
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
        return replace(self.vehicle, vehicle=vehicle, interface="wrench", latency=0.0)

    def disturbance(self, disturbance: Floats) -> Floats:
        """Return d_Q, d_B and d_τ (N, N·m) that act on the equivalent pendulum like those on the vehicle, (n, 9)."""
        p, out = self.parameters, Disturbance(disturbance.copy())
        share = self.vehicle.parameters.rod_length / p.rod_length
        out.force[:] += (1.0 - share) * out.bob_force
        out.bob_force[:] *= share
        # Horizontally, the disturbance of s̈ acts on σ̈ with the factor 1/(1 + μ), and moves the equilibrium of σ.
        drift = (out.bob_force[:, :2] / p.bob_mass - out.force[:, :2] / p.quadrotor_mass) / p.rod_length
        out.bob_force[:, :2] -= p.bob_mass * p.gravity / p.chain_stiffness * self.pivot_share * drift
        wanted = (1.0 - self.pivot_share) * p.rod_length * drift
        out.force[:, :2] = p.quadrotor_mass * (out.bob_force[:, :2] / p.bob_mass - wanted)
        return out.array

    def reference(self, reference: Floats) -> Floats:
        """Return the derivatives of F for those of F_d by equation (3); both of orders 2 … 6, shape (n, 5, 3)."""
        second, fourth = self._series
        out = reference.copy()
        out[:, :-2, :2] += second * reference[:, 2:, :2]
        out[:, :-4, :2] += fourth * reference[:, 4:, :2]
        return out

    def reference_offset(self, reference: Floats) -> Floats | float:
        """Return F − F_d of equation (3), the offset of the wanted F from the reference, m, shape (n, 2)."""
        second, fourth = self._series
        return np.asarray(second * reference[:, 0, :2] + fourth * reference[:, 2, :2])

    @cached_property
    def _series(self) -> tuple[float, float]:
        """c₂ (s²) and c₂² + c₄ (s⁴) of equation (3)."""
        p, ratio = self.parameters, self.pivot_share / (1.0 - self.pivot_share)
        second = (self.pendulum_arm + self.thrust_arm) / p.gravity
        return second, second**2 + (ratio * self.pendulum_arm - self.thrust_arm) / (p.gravity * p.chain_stiffness)

    def _of_pole(self, trajectory: flat_outputs.FlatTrajectory) -> flat_outputs.FlatTrajectory:
        """Return the trajectory with s in place of σ."""
        pendulum = self.pendulum(trajectory.pendulum_tangent[:3], trajectory.thrust_tangent)
        vertical = flat_outputs.vertical_component(pendulum)
        return trajectory._replace(pendulum_tangent=pendulum, pendulum_vertical=vertical)

    def body_command(self, state: Floats, command: Floats, disturbance: Floats) -> Floats:
        """Return a command with torques about the body's axes for one with torques for the Euler angles, (n, 4)."""
        p = self.vehicle.parameters
        inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
        acceleration = (command[:, 1:] + Disturbance(disturbance).torque) / inertia
        torques = body_torques(state, acceleration, command[:, 0], disturbance, self.vehicle)
        return np.column_stack([command[:, 0], torques])

    def tangents(self, direction: Floats, tilt: Floats, thrust_axis: Floats) -> tuple[Floats, Floats]:
        """Return s and t, shape (n, 2), for r and b, shape (n, 3), and the tilt n, rad, shape (n, 2)."""
        pendulum = direction[:, :2] / np.maximum(direction[:, 2:], _LEAST_VERTICAL)
        return pendulum, thrust_axis[:, :2] / np.maximum(thrust_axis[:, 2:], _LEAST_VERTICAL)

    def pendulum_rate(self, direction: Floats, direction_rate: Floats, pendulum: Floats) -> Floats:
        """Return ṡ for r, ṙ and s, rad/s, shape (n, 2)."""
        change = direction_rate[:, :2] - pendulum * direction_rate[:, 2:]
        return np.asarray(change / np.maximum(direction[:, 2:], _LEAST_VERTICAL))

    def direction_rate(self, direction: Floats, pendulum_rate: Floats) -> Floats:
        """Return the horizontal ṙ for r and ṡ, 1/s, shape (n, 2)."""
        horizontal, r_z = direction[:, :2], direction[:, 2:]
        along = np.sum(horizontal * pendulum_rate, axis=1, keepdims=True)
        return np.asarray(r_z * (pendulum_rate - along * horizontal))

    def tilt_rate(self, state: Floats, yaw: Floats) -> Floats:
        """Return ṫ for states, shape (n, 18), in rad/s, shape (n, 2)."""
        return np.asarray(_tilt_series(state)[1])

    def angular_accelerations(self, before: Floats, after: Floats, period: float) -> Floats:
        """Return the mean accelerations of tilt and yaw between two states, as φ, θ and ψ near hover, (n, 3)."""
        angular = super().angular_accelerations(before, after, period)
        tilt = (_tilt_series(after)[1] - _tilt_series(before)[1]) / period
        angular[:, [1, 0]] = rotate(tilt, -State(before).euler[:, 2], 0) * [1.0, -1.0]
        return angular

    def euler_accelerations(self, state: Floats, acceleration: Floats) -> Floats:
        """Return the accelerations of the Euler angles that make those of tilt and yaw, rad/s², shape (n, 3)."""
        s, series = State(state), _tilt_series(state)
        second = rotate(acceleration[:, [1, 0]] * [1.0, -1.0], s.euler[:, 2], 0)
        yaw = taylor.from_derivatives(s.euler[:, 2], s.euler_rate[:, 2], acceleration[:, 2])
        attitude = flat_outputs.attitude_from_tangent(np.stack([*series, 0.5 * second]), yaw)
        return np.asarray(taylor.to_derivatives(attitude)[2])


def _tilt_series(state: Floats) -> Floats:
    """Return the Taylor series of the tangent t of states, order 1, shape (2, n, 2)."""
    s = State(state)
    euler = np.column_stack([np.clip(s.euler[:, :2], -_MAX_ANGLE, _MAX_ANGLE), s.euler[:, 2]])
    return flat_outputs.tangent_from_attitude(taylor.from_derivatives(euler, s.euler_rate))


@lru_cache(maxsize=64)
def equivalent_model(simulation: Simulation) -> EquivalentModel:
    """Return the equivalent pendulum of a vehicle."""
    rigid = isinstance(plant_of(simulation), RigidPlant)
    return RigidEquivalentModel(simulation) if rigid else EquivalentModel(simulation)
