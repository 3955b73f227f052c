"""The paper's model, derived by sympy from the energies (1)–(5) and linearised at hover."""

from dataclasses import dataclass

import sympy as sp

M, m_c, length, g, I_phi, I_theta, I_psi = PARAMETERS = sp.symbols("M m_c l g I_phi I_theta I_psi", positive=True)
x, y, z, phi, theta, psi = sp.symbols("x y z phi theta psi", real=True)
u, tau_phi, tau_theta, tau_psi = COMMAND = sp.symbols("u tau_phi tau_theta tau_psi", real=True)
FORCE_ON_QUADROTOR = sp.symbols("d_x d_y d_z", real=True)
FORCE_ON_BOB = sp.symbols("b_x b_y b_z", real=True)

# R e₃ with R = Rz(ψ) Ry(θ) Rx(φ)
THRUST_AXIS = (
    sp.rot_ccw_axis3(psi) * sp.rot_ccw_axis2(theta) * sp.rot_ccw_axis1(phi) * sp.Matrix([0, 0, 1])
).applyfunc(sp.expand)

# Coordinates and direction of the pendulum: the paper's spherical angles, and the horizontal components of r, which are
# regular when the pendulum is upright.
alpha, beta = sp.symbols("alpha beta", real=True)
r_x, r_y = sp.symbols("r_x r_y", real=True)
SPHERICAL = (alpha, beta), sp.Matrix([sp.sin(alpha) * sp.cos(beta), sp.sin(alpha) * sp.sin(beta), sp.cos(alpha)])
HORIZONTAL = (r_x, r_y), sp.Matrix([r_x, r_y, sp.sqrt(1 - r_x**2 - r_y**2)])


def rate_of(symbol: sp.Symbol) -> sp.Symbol:
    """Return the symbol of a coordinate's time derivative."""
    return sp.Symbol(f"{symbol.name}'", real=True)


@dataclass(frozen=True)
class Model:
    """M(q) q̈ + C(q, q̇) q̇ + G(q) = B(q) [u τ]ᵀ for one choice of the pendulum's two coordinates.

    Attributes:
        q: Coordinates, 8.
        q_dot: Rates, 8.
        mass: M, 8 × 8.
        coriolis: C, which consists of Christoffel symbols, 8 × 8.
        gravity: G, 8.
        inputs: B, 8 × 4.
        forces: Matrices of generalised forces for a force on the quadrotor and a force on the bob, 8 × 3 each.
    """

    q: sp.Matrix
    q_dot: sp.Matrix
    mass: sp.Matrix
    coriolis: sp.Matrix
    gravity: sp.Matrix
    inputs: sp.Matrix
    forces: tuple[sp.Matrix, sp.Matrix]


def derive(pendulum: tuple[tuple[sp.Symbol, sp.Symbol], sp.Matrix]) -> Model:
    """Derive the model for `SPHERICAL` or `HORIZONTAL` coordinates of the pendulum."""
    angles, direction = pendulum
    q = sp.Matrix([x, y, z, phi, theta, psi, *angles])
    q_dot = q.applyfunc(rate_of)
    quadrotor, euler = q[0:3, :], q[3:6, :]
    bob = quadrotor + length * direction
    velocity, bob_velocity, euler_rate = (part.jacobian(q) * q_dot for part in (quadrotor, bob, euler))
    inertia = sp.diag(I_phi, I_theta, I_psi)
    kinetic = (M * velocity.dot(velocity) + m_c * bob_velocity.dot(bob_velocity)) / 2  # (2), (3)
    kinetic += (euler_rate.T * inertia * euler_rate)[0] / 2
    potential = M * g * quadrotor[2] + m_c * g * bob[2]  # (4), (5)
    momentum = sp.Matrix([kinetic]).jacobian(q_dot).T
    mass = momentum.jacobian(q_dot).applyfunc(sp.trigsimp)
    mass_rate = mass.applyfunc(lambda entry: (sp.Matrix([entry]).jacobian(q) * q_dot)[0])
    by_position = (mass * q_dot).jacobian(q)
    return Model(
        q,
        q_dot,
        mass,
        ((mass_rate + by_position - by_position.T) / 2).applyfunc(sp.trigsimp),
        sp.Matrix([potential]).jacobian(q).T,
        sp.Matrix.hstack(quadrotor.jacobian(q).T * THRUST_AXIS, euler.jacobian(q).T),
        (quadrotor.jacobian(q).T, bob.jacobian(q).T),
    )


def linearise() -> dict[sp.Symbol, sp.Expr]:
    """Return the time derivative of every coordinate and rate near hover with the pendulum upright.

    The coordinates of the pendulum are r_x and r_y, which are regular there; the thrust is a deviation from the weight.
    """
    model = derive(HORIZONTAL)
    on_quadrotor, on_bob = model.forces
    inputs = sp.Matrix([*COMMAND, *FORCE_ON_QUADROTOR, *FORCE_ON_BOB])
    hover = {COMMAND[0]: (M + m_c) * g, **dict.fromkeys(inputs[1:], 0), **dict.fromkeys(model.q, 0)}
    force = model.inputs * sp.Matrix(COMMAND) + on_quadrotor * inputs[4:7, :] + on_bob * inputs[7:10, :] - model.gravity
    assert force.subs(hover).expand().is_zero_matrix
    deviation = force.jacobian(model.q).subs(hover) * model.q + force.jacobian(inputs).subs(hover) * inputs
    acceleration = model.mass.subs(hover).LUsolve(deviation).applyfunc(sp.factor)
    return dict(zip(model.q, model.q_dot, strict=True)) | dict(zip(model.q_dot, acceleration, strict=True))
