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

    (3)  F⁽ⁱ⁾ = F_d⁽ⁱ⁾ + c₂ F⁽ⁱ⁺²⁾ + c₄ F⁽ⁱ⁺⁴⁾ + a s_f⁽ⁱ⁾ + b t_f⁽ⁱ⁾,    c₂ = (a + b)/g,    c₄ = (μ a − b)/(g K)
    (4)  s_f = −d_B/(m g),    t_f = −(d_Q + d_B)/((M + m) g)

for the drags d_Q and d_B on the trajectory. Derivatives of F_d above the highest in the observation, order 6, and those
of the drag are taken for those of oscillations: each is −Ω times that two orders lower, with the symmetric part of

    (5)  Ω = −Σ F_d⁽ⁱ⁺²⁾ F_d⁽ⁱ⁾ᵀ K⁻ⁱ (Σ F_d⁽ⁱ⁾ F_d⁽ⁱ⁾ᵀ K⁻ⁱ)⁻¹,    i = 2, 3, 4

with eigenvalues limited to 0 … K/2; `_LEAST` keeps the inverse finite. But for both this is exact for F_d on circles
and figure eights. Left out are derivatives of the drag in (4), and what the drag adds to F⁽ⁱ⁺²⁾ and F⁽ⁱ⁺⁴⁾ in (3). For
the paper's vehicle λ = l, m' = m and μ = a = b = 0.

The functions of `Pendulum` take the numbers of this model. For rigid vehicles `rigid` is their `RigidSettings`; it is
None for the paper's vehicle.
"""

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from quadpend_baselines.modelling.flat_outputs import (
    FlatTrajectory,
    flat_trajectory,
    state_and_command,
    vertical_component,
)
from quadpend_baselines.modelling.inverse_dynamics import body_torques
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    divide,
    load_forces,
    load_reference,
    load_state,
    minus,
    store_vectors,
)
from quadpend_baselines.modelling.taylor import Pair, Series, Triple, plus, times
from quadpend_baselines.modelling.trajectory_drag import forces_now, plus_constant, trajectory_drag
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.rigid_settings import RigidSettings, pack_rigid, unpack_rigid
from quadpend_gym.physics.state import STATE_SIZE
from quadpend_gym.physics.vectors import Four, Vec3, axpy, load_four, norm, store_four
from quadpend_gym.vehicles import Drag, Pole, Vehicle

_SMALL, _LEAST = 1e-9, 1e-3  # of the sums of (5), m²/s⁴ and a share of their trace; `_SMALL` also of Ω, 1/s²
_FASTEST = 0.5  # bound of Ω/K


class Pendulum(NamedTuple):
    """The equivalent pendulum of a vehicle."""

    physics: Parameters  # of the equivalent pendulum: M', m' and λ
    vehicle: Parameters  # of the vehicle
    pivot_share: float  # μ/(1 + μ), the share of t in σ
    pendulum_arm: float  # a, m
    thrust_arm: float  # b, m
    second: float  # c₂ of equation (3), s²
    fourth: float  # c₄ of equation (3), s⁴


unpack_pendulum = unpacker(Pendulum)


@inlined
def chain_stiffness(p: Parameters) -> float:
    """Return K = (M + m) g/(M l), 1/s²."""
    return (p.quadrotor_mass + p.bob_mass) * p.gravity / (p.quadrotor_mass * p.rod_length)


@inlined
def sigma_of(pendulum: Vec3, tilt: Vec3, model: Pendulum) -> Vec3:
    """Return σ, or its rate, for s and t or their rates."""
    return axpy(model.pivot_share, minus(tilt, pendulum), pendulum)


@inlined
def pendulum_of(sigma: Vec3, tilt: Vec3, model: Pendulum) -> Vec3:
    """Return s for σ and t, or their rates: the inverse of `sigma_of`."""
    return divide(axpy(-model.pivot_share, tilt, sigma), 1.0 - model.pivot_share)


@inlined
def flat_output(bob: Vec3, pendulum: Vec3, tilt: Vec3, model: Pendulum) -> Vec3:
    """Return F of equation (2), or its rate, for ζ + l r, s and t, or their rates."""
    return axpy(model.thrust_arm, tilt, axpy(model.pendulum_arm, pendulum, bob))


@inlined
def equivalent_forces(forces: tuple[Triple, Triple], model: Pendulum) -> tuple[Triple, Triple]:
    """Return the forces on quadrotor and bob of the equivalent pendulum that act like those on a vehicle, N."""
    body, bob = forces
    x, y = _horizontal(body.x, bob.x, model), _horizontal(body.y, bob.y, model)
    z = _shared(body.z, bob.z, model)
    return Triple(x[0], y[0], z[0]), Triple(x[1], y[1], z[1])


@inlined
def _shared(body: Series, bob: Series, model: Pendulum) -> tuple[Series, Series]:
    """Return body + (1 − l/λ) bob and l/λ bob."""
    share = model.vehicle.rod_length / model.physics.rod_length
    return plus(body, times(1.0 - share, bob)), times(share, bob)


@inlined
def _horizontal(body: Series, bob: Series, model: Pendulum) -> tuple[Series, Series]:
    """Return the forces of a horizontal axis.

    With f = d_B/m' − d_Q/M' of `_shared`, s̈ has the part f/λ, σ̈ the part f/((1 + μ) λ), and σ at rest the part
    μ f/((1 + μ) K λ).
    """
    p, (force, bob_force) = model.physics, _shared(body, bob, model)
    relative = plus(times(1.0 / p.bob_mass, bob_force), times(-1.0 / p.quadrotor_mass, force))
    moved = -p.bob_mass * p.gravity / chain_stiffness(p) * model.pivot_share / p.rod_length
    on_bob, kept = plus(bob_force, times(moved, relative)), (1.0 - model.pivot_share) * p.quadrotor_mass
    return plus(times(p.quadrotor_mass / p.bob_mass, on_bob), times(-kept, relative)), on_bob


class Symmetric(NamedTuple):
    """The matrix [[m + p, q], [q, m − p]]."""

    m: float
    p: float
    q: float


@inlined
def _times(matrix: Symmetric, x: float, y: float) -> tuple[float, float]:
    m, p, q = matrix
    return (m + p) * x + q * y, q * x + (m - p) * y


@inlined
def _plus_product(v: Vec3, matrix: Symmetric, w: Vec3) -> Vec3:
    """Return v + matrix w, horizontally."""
    x, y = _times(matrix, w.x, w.y)
    return Vec3(v.x + x, v.y + y, v.z)


@inlined
def _oscillations(reference: Derivatives, stiffness: float) -> tuple[Symmetric, float, float]:
    """Return Ω of equation (5) and its eigenvalues, 1/s²."""
    d2, d3, d4, d5, d6 = reference.d2, reference.d3, reference.d4, reference.d5, reference.d6
    u, v = 1.0 / stiffness, 1.0 / (stiffness * stiffness)
    xx, yy = d2.x * d2.x + u * d3.x * d3.x + v * d4.x * d4.x, d2.y * d2.y + u * d3.y * d3.y + v * d4.y * d4.y
    xy, least = d2.x * d2.y + u * d3.x * d3.y + v * d4.x * d4.y, _LEAST * (xx + yy) + _SMALL
    xx, yy = xx + least, yy + least
    a, b = d4.x * d2.x + u * d5.x * d3.x + v * d6.x * d4.x, d4.x * d2.y + u * d5.x * d3.y + v * d6.x * d4.y
    c, d = d4.y * d2.x + u * d5.y * d3.x + v * d6.y * d4.x, d4.y * d2.y + u * d5.y * d3.y + v * d6.y * d4.y
    per = -0.5 / (xx * yy - xy * xy)
    first, second = per * (a * yy - b * xy), per * (d * xx - c * xy)
    m, p, q = first + second, first - second, per * (b * xx - a * xy + c * yy - d * xy)
    apart, most = norm(Vec3(p, q, 0.0)), _FASTEST * stiffness
    low, high = min(max(m - apart, 0.0), most), min(max(m + apart, 0.0), most)
    share = 0.5 * (high - low) / max(apart, _SMALL)
    return Symmetric(0.5 * (low + high), share * p, share * q), low, high


@inlined
def equivalent_reference(reference: Derivatives, drag: tuple[Triple, Triple], model: Pendulum) -> Derivatives:
    """Return the derivatives of F for those of F_d in drag (N), by equation (3)."""
    d, (body, bob), p = reference, drag, model.vehicle
    second, fourth = model.second, model.fourth
    square, low, high = _oscillations(reference, chain_stiffness(model.physics))
    further = Symmetric(second - fourth * square.m, -fourth * square.p, -fourth * square.q)
    # 1/(1 + c₂ Ω − c₄ Ω²) by its eigenvalues
    of_low, of_high = 1.0 / (1.0 + low * (second - fourth * low)), 1.0 / (1.0 + high * (second - fourth * high))
    share = (of_high - of_low) / max(high - low, _SMALL)
    gain = Symmetric(0.5 * (of_low + of_high), share * square.p, share * square.q)
    none = Vec3(0.0, 0.0, 0.0)
    d5, d6 = _plus_product(none, gain, d.d5), _plus_product(none, gain, d.d6)
    d3, d4 = _plus_product(d.d3, further, d5), _plus_product(d.d4, further, d6)
    d2 = axpy(fourth, d6, axpy(second, d4, d.d2))
    of_bob = model.pendulum_arm / (p.bob_mass * p.gravity)
    of_both = model.thrust_arm / ((p.quadrotor_mass + p.bob_mass) * p.gravity)
    x = plus(times(of_both, body.x), times(of_bob + of_both, bob.x))
    y = plus(times(of_both, body.y), times(of_bob + of_both, bob.y))
    return Derivatives(
        _plus_product(Vec3(d2.x, d2.y, d.d2.z), square, Vec3(x.a, y.a, 0.0)),
        _plus_product(d3, square, Vec3(x.b, y.b, 0.0)),
        _plus_product(d4, square, Vec3(2.0 * x.c, 2.0 * y.c, 0.0)),
        _plus_product(Vec3(d5.x, d5.y, d.d5.z), square, Vec3(6.0 * x.d, 6.0 * y.d, 0.0)),
        _plus_product(Vec3(d6.x, d6.y, d.d6.z), square, Vec3(24.0 * x.e, 24.0 * y.e, 0.0)),
        d.yaw,
        d.d1,
        d.drag,
    )


@inlined
def follow(reference: Derivatives, constant: Forces, model: Pendulum) -> tuple[VehicleState, Four, Forces]:
    """Return the state and the command that follow a reference in a constant disturbance and drag, and these forces.

    The state has position and velocity relative to the reference. The command is thrust (N) and the torques that
    accelerate the Euler angles (N·m); `body_command` converts it.
    """
    drag = trajectory_drag(reference, model.vehicle, chain_stiffness(model.physics))
    forces, share = plus_constant(drag, constant), model.pivot_share
    followed = equivalent_reference(reference, drag, model)
    path = flat_trajectory(followed, equivalent_forces(forces, model), model.physics)
    pole = Pair(  # s in place of σ
        times(1.0 / (1.0 - share), plus(path.pendulum.x, times(-share, path.tangent.x))),
        times(1.0 / (1.0 - share), plus(path.pendulum.y, times(-share, path.tangent.y))),
    )
    of_pole = FlatTrajectory(pole, vertical_component(pole), path.thrust, path.tangent)
    state, command = state_and_command(of_pole, reference.yaw, constant.torque, model.physics, model.vehicle.rod_length)
    return state, command, forces_now(forces, constant)


@inlined
def body_command(
    state: VehicleState, command: Four, forces: Forces, model: Pendulum, rigid: RigidSettings | None
) -> Four:
    """Return a command with torques about the body's axes for one with torques τ that accelerate the Euler angles η.

    I η̈ = τ + d_τ. The disturbance is that of the vehicle, N and N·m.
    """
    if rigid is None:
        return command
    p, torque = model.physics, forces.torque
    acceleration = Vec3(
        (command.b + torque.x) / p.inertia_roll,
        (command.c + torque.y) / p.inertia_pitch,
        (command.d + torque.z) / p.inertia_yaw,
    )
    torques = body_torques(state, acceleration, command.a, forces, model.vehicle, rigid)
    return Four(command.a, torques.x, torques.y, torques.z)


@compiled
def _follow(reference: Floats, disturbance: Floats, packed: Floats, state: Floats, command: Floats) -> None:
    model = unpack_pendulum(packed)
    for row in range(state.shape[0]):
        desired, feedforward, _ = follow(load_reference(reference.T, 0, row), load_forces(disturbance.T, 0, row), model)
        store_vectors(state.T, 0, row, desired)
        store_four(command.T, 0, row, feedforward)


@compiled
def _body_commands(
    state: Floats, command: Floats, disturbance: Floats, packed: Floats, packed_rigid: Floats, out: Floats
) -> None:
    model, rigid = unpack_pendulum(packed), unpack_rigid(packed_rigid)
    for row in range(state.shape[0]):
        given, forces = load_four(command.T, 0, row), load_forces(disturbance.T, 0, row)
        store_four(out.T, 0, row, body_command(load_state(state.T, 0, row), given, forces, model, rigid))


class EquivalentModel:
    """The equivalent pendulum of a vehicle, and its functions for n rows.

    Args:
        simulation: The vehicle.

    Attributes:
        parameters: M', m' and λ; the other parameters are those of the vehicle.
        numbers: The model inside compiled functions.
        packed, packed_rigid: Flat arrays of `numbers` and of the settings of a rigid vehicle (or None).
    """

    def __init__(self, simulation: Simulation) -> None:
        """Compute the parameters of the equivalent pendulum."""
        self.vehicle, p, second, fourth = simulation, simulation.parameters, 0.0, 0.0
        self.parameters, self.packed_rigid = p, None
        share_of_pivot, pendulum_arm, thrust_arm = 0.0, 0.0, 0.0
        if simulation.vehicle.attitude == "rigid":
            self.packed_rigid = pack_rigid(simulation)
            length = p.rod_length + simulation.vehicle.pole.inertia / (p.bob_mass * p.rod_length)
            mass = p.bob_mass * p.rod_length / length
            height, share = simulation.vehicle.pivot[2], p.bob_mass / p.total_mass
            free = (1.0 - share) * height
            ratio = free / (length - share * p.rod_length)
            arm = free / (1.0 + ratio)
            self.parameters = p._replace(quadrotor_mass=p.total_mass - mass, bob_mass=mass, rod_length=length)
            share_of_pivot, pendulum_arm = ratio / (1.0 + ratio), length - p.rod_length - arm
            thrust_arm = share * height + arm
            second = (pendulum_arm + thrust_arm) / p.gravity
            stiffness = p.gravity * self.parameters.chain_stiffness
            fourth = (ratio * pendulum_arm - thrust_arm) / stiffness
        physics = (self.parameters, p)
        self.numbers = Pendulum(*physics, share_of_pivot, pendulum_arm, thrust_arm, second, fourth)
        self.packed = pack(self.numbers)

    @cached_property
    def simulation(self) -> Simulation:
        """The equivalent pendulum with the paper's attitude model.

        Its torque limits, relative to K and the inertia, are those of the paper's vehicle, but at most those of the
        vehicle. They are the unit of effort of a controller; most rotors can make much larger torques.
        """
        if self.packed_rigid is None:
            return self.vehicle
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
        rows = len(reference)
        state, command, given = np.empty((rows, STATE_SIZE)), np.empty((rows, 4)), reference.reshape(rows, -1)
        _follow(np.hstack([given, yaw_reference]), np.ascontiguousarray(disturbance), self.packed, state, command)
        return state, command

    def body_command(self, state: Floats, command: Floats, disturbance: Floats) -> Floats:
        """Return a command with torques about the body's axes for one with torques for the Euler angles, shape (n, 4).

        The latter has thrust (N) and torques that accelerate the Euler angles η in the disturbance, I η̈ = τ + d_τ.
        """
        if self.packed_rigid is None:
            return command
        out = np.empty(command.shape)
        states, acting = np.ascontiguousarray(state), np.ascontiguousarray(disturbance)
        _body_commands(states, np.ascontiguousarray(command), acting, self.packed, self.packed_rigid, out)
        return out


@lru_cache(maxsize=64)
def equivalent_model(simulation: Simulation) -> EquivalentModel:
    """Return the equivalent pendulum of a vehicle."""
    return EquivalentModel(simulation)
