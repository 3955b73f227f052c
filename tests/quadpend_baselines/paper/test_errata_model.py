"""The paper's model, (1)–(7) and (17)–(19), compared entry by entry with what sympy derives from the paper's energies.

A test named `…_as_printed` shows that the printed equation is right. Each other test shows that the printed form fails
and the corrected form holds. docs/paper.md lists all equations.
"""

import pytest
import sympy as sp

from tests.helpers.symbolic import (
    COMMAND,
    SPHERICAL,
    THRUST_AXIS,
    I_phi,
    I_psi,
    I_theta,
    M,
    Model,
    alpha,
    beta,
    derive,
    g,
    length,
    m_c,
    phi,
    psi,
    rate_of,
    theta,
    u,
    vanishes,
    z,
)

S_alpha, C_alpha, S_beta, C_beta = sp.sin(alpha), sp.cos(alpha), sp.sin(beta), sp.cos(beta)
S_phi, C_phi, S_theta, C_theta = sp.sin(phi), sp.cos(phi), sp.sin(theta), sp.cos(theta)
S_psi, C_psi = sp.sin(psi), sp.cos(psi)
alpha_dot, beta_dot = rate_of(alpha), rate_of(beta)
SWING = sp.Matrix([alpha_dot, beta_dot])
POSITION, EULER, PENDULUM = slice(0, 3), slice(3, 6), slice(6, 8)

# Blocks of (7): Θ, Γ, Y and Ψ are corrected, the others are as printed.
THETA = (
    m_c
    * length
    * sp.Matrix([[C_alpha * C_beta, -S_alpha * S_beta], [C_alpha * S_beta, S_alpha * C_beta], [-S_alpha, 0]])
)
PHI = m_c * length**2 * sp.diag(1, S_alpha**2)
Y = (
    m_c
    * length
    * sp.Matrix(
        [
            [
                -(alpha_dot * S_alpha * C_beta + beta_dot * C_alpha * S_beta),
                -(alpha_dot * C_alpha * S_beta + beta_dot * S_alpha * C_beta),
            ],
            [
                -alpha_dot * S_alpha * S_beta + beta_dot * C_alpha * C_beta,
                alpha_dot * C_alpha * C_beta - beta_dot * S_alpha * S_beta,
            ],
            [-alpha_dot * C_alpha, 0],
        ]
    )
)
PSI = (
    m_c
    * length**2
    * sp.Matrix([[0, -beta_dot * S_alpha * C_alpha], [beta_dot * S_alpha * C_alpha, alpha_dot * S_alpha * C_alpha]])
)


def replaced(matrix: sp.Matrix, entries: dict[tuple[int, int], sp.Expr], factor: sp.Expr) -> sp.Matrix:
    """Return a copy with the given entries, multiplied by the factor in front of the printed matrix."""
    printed = matrix.copy()
    for place, entry in entries.items():
        printed[place] = factor * entry
    return printed


@pytest.fixture(scope="module")
def model() -> Model:
    return derive(SPHERICAL)


def test_6_and_7_are_the_same_equation(model: Model) -> None:
    """d/dt ∂L/∂q̇ − ∂L/∂q equals C q̇ + G with Christoffel symbols in C; the attitude block of C is zero."""
    kinetic = (model.q_dot.T * model.mass * model.q_dot)[0] / 2
    potential = (M + m_c) * g * z + m_c * g * length * C_alpha  # (4) + (5) as printed
    momentum = model.mass * model.q_dot
    bias = momentum.jacobian(model.q) * model.q_dot - sp.Matrix([kinetic - potential]).jacobian(model.q).T
    assert vanishes(model.coriolis * model.q_dot + model.gravity - bias)
    assert model.coriolis[EULER, :].is_zero_matrix
    assert model.coriolis[:, EULER].is_zero_matrix


def test_7_needs_u_in_r4(model: Model) -> None:
    """[f τ 0 0]ᵀ ∈ R⁸ is right in (6), as the generalised force, but B of (7) is 8 × 4 and needs a vector in R⁴."""
    tau = sp.Matrix(COMMAND[1:])
    printed = sp.Matrix([u * THRUST_AXIS, tau, sp.zeros(2, 1)])
    right = sp.Matrix([u, tau])
    assert model.inputs.shape == (8, 4)
    with pytest.raises(sp.matrices.exceptions.ShapeError):
        model.inputs * printed
    assert vanishes(model.inputs * right - printed)


def test_theta_matrix_entry_31(model: Model) -> None:
    """Θ₃₁ = −Sα, printed +Sα."""
    printed = replaced(THETA, {(2, 0): S_alpha}, m_c * length)
    assert vanishes(THETA - model.mass[POSITION, PENDULUM])
    assert not vanishes(printed - model.mass[POSITION, PENDULUM])


def test_gamma_matrix_entry_21(model: Model) -> None:
    """Γᵀ₂₁ = +CαSβ, printed −CαSβ. The corrected Γ is exactly Θᵀ."""
    printed_transposed = replaced(THETA, {(1, 0): -C_alpha * S_beta}, m_c * length)
    assert vanishes(THETA.T - model.mass[PENDULUM, POSITION])
    assert not vanishes(printed_transposed.T - model.mass[PENDULUM, POSITION])


def test_printed_mass_matrix_is_not_symmetric() -> None:
    """A mass matrix of a kinetic energy is symmetric in all coordinates."""
    theta_printed = replaced(THETA, {(2, 0): S_alpha}, m_c * length)
    gamma_printed = replaced(THETA, {(1, 0): -C_alpha * S_beta}, m_c * length).T
    assert not vanishes(gamma_printed - theta_printed.T)


def test_phi_matrix_as_printed(model: Model) -> None:
    assert vanishes(PHI - model.mass[PENDULUM, PENDULUM])


def test_mass_matrix_blocks_and_determinant(model: Model) -> None:
    """det M is zero if and only if sin α = 0, so (α, β) cannot be integrated through the upright position."""
    assert vanishes(model.mass[POSITION, POSITION] - (M + m_c) * sp.eye(3))
    assert vanishes(
        model.mass[EULER, :] - sp.Matrix.hstack(sp.zeros(3), sp.diag(I_phi, I_theta, I_psi), sp.zeros(3, 2))
    )
    expected = I_phi * I_theta * I_psi * M**2 * m_c**2 * length**4 * (M + m_c) * S_alpha**2
    assert vanishes(model.mass.det(method="berkowitz") - expected)


def test_y_matrix_rows_1_and_2(model: Model) -> None:
    """The printed rows lack sines and cosines of β; even their force Y (α̇, β̇)ᵀ is wrong."""
    last = -(alpha_dot * C_alpha * C_beta + beta_dot * S_alpha)
    entries = {
        (0, 0): -(alpha_dot * S_alpha + beta_dot * C_alpha * S_beta),
        (0, 1): last,
        (1, 0): -(alpha_dot * S_alpha + beta_dot * C_alpha * C_beta),
        (1, 1): last,
    }
    printed = replaced(Y, entries, m_c * length)
    force = model.coriolis[POSITION, PENDULUM] * SWING
    assert vanishes(Y - model.coriolis[POSITION, PENDULUM])
    for row in (0, 1):
        assert not vanishes((printed * SWING - force)[row])


def test_y_matrix_row_3_as_printed(model: Model) -> None:
    printed = m_c * length * sp.Matrix([[-alpha_dot * C_alpha, 0]])
    assert vanishes(printed - model.coriolis[2, PENDULUM])


def test_psi_matrix_row_2(model: Model) -> None:
    """β̇SαCα and α̇SαCα, printed with Cβ for Cα: the force on β would depend on the choice of β = 0."""
    printed = replaced(
        PSI, {(1, 0): beta_dot * S_alpha * C_beta, (1, 1): alpha_dot * S_alpha * C_beta}, m_c * length**2
    )
    force = model.coriolis[PENDULUM, PENDULUM] * SWING
    assert vanishes(PSI - model.coriolis[PENDULUM, PENDULUM])
    assert not vanishes((printed * SWING - force)[1])


def test_psi_matrix_row_1_as_printed(model: Model) -> None:
    printed = m_c * length**2 * sp.Matrix([[0, -beta_dot * S_alpha * C_alpha]])
    assert vanishes(printed - model.coriolis[6, PENDULUM])


def test_gravity_vector_and_input_matrix_as_printed(model: Model) -> None:
    """G depends on q only, although the paper writes G(q̇, q)."""
    gravity = sp.Matrix([0, 0, g * (M + m_c), 0, 0, 0, -m_c * length * g * S_alpha, 0])
    inputs = sp.Matrix(
        sp.BlockMatrix(
            [[THRUST_AXIS, sp.zeros(3)], [sp.zeros(3, 1), sp.eye(3)], [sp.zeros(2, 1), sp.zeros(2, 3)]]
        ).as_explicit()
    )
    assert vanishes(gravity - model.gravity)
    assert vanishes(inputs - model.inputs)


@pytest.fixture(scope="module")
def height_acceleration(model: Model) -> sp.Expr:
    """Return z̈ of (7), with the accelerations of the pendulum eliminated."""
    couple, swing = model.mass[POSITION, PENDULUM], model.mass[PENDULUM, PENDULUM]
    through = couple * swing.inv()
    force = model.inputs * sp.Matrix(COMMAND) - model.coriolis * model.q_dot - model.gravity
    schur = model.mass[POSITION, POSITION] - through * couple.T
    direction = SPHERICAL[1]
    inverse = (sp.eye(3) - m_c / (M + m_c) * direction * direction.T) / M
    assert vanishes(schur * inverse - sp.eye(3))
    return (inverse * (force[POSITION, :] - through * force[PENDULUM, :]))[2]


def test_17_as_printed_and_18_g_z(height_acceleration: sp.Expr) -> None:
    """g_z ends in SθCφ, printed SθCψ; the printed coupling of pitch and pendulum is wrong by cos ψ/cos φ."""

    def thrust_gain(misprinted: sp.Expr) -> sp.Expr:
        tilt = (C_psi * S_beta - S_psi * C_beta) * S_phi - (C_psi * C_beta + S_psi * S_beta) * S_theta * misprinted
        upright = (M + m_c) * C_theta * C_phi - m_c * C_alpha**2 * C_phi * C_theta
        return (m_c * tilt * S_alpha * C_alpha + upright) / (M * (M + m_c))

    derived = sp.diff(height_acceleration, u)
    assert vanishes(thrust_gain(C_phi) - derived)
    assert not vanishes(thrust_gain(C_psi) - derived)


def test_19_f_z_as_printed(height_acceleration: sp.Expr) -> None:
    swing = m_c * length * (beta_dot**2 * (C_alpha - C_alpha**3) + alpha_dot**2 * C_alpha)
    printed = (swing - (M + m_c) * g) / (M + m_c)
    assert vanishes(printed - height_acceleration.subs(u, 0))
