"""The paper's matrix form of the equations of motion with its errors corrected, used in tests only.

    (7)  M(q) q̈ + C(q, q̇) q̇ + G(q) = B(q) [u τφ τθ τψ]ᵀ,        q = [x y z φ θ ψ α β]ᵀ

         | (M+m_c) I  0    Θ |         | 0  0  Y |         | (M+m_c) g e₃ |         | R e₃  0 |
    M =  |     0      I_Q  0 |    C =  | 0  0  0 |    G =  |      0       |    B =  |  0    I |
         |     Θᵀ     0    Φ |         | 0  0  Ψ |         |     G_μ      |         |  0    0 |

with S and C for sine and cosine, r = (Sα Cβ, Sα Sβ, Cα), blocks of 3, 3 and 2 coordinates, and

    Θ   = m_c l ∂r/∂(α, β)                      Φ = m_c l² diag(1, Sα²)
    Y   = dΘ/dt                                 I_Q = diag(I_φ, I_θ, I_ψ)
    Ψ   = m_c l² Sα Cα [[0, −β̇], [β̇, α̇]]        G_μ = (−m_c g l Sα, 0)

C consists of the Christoffel symbols of M, so Ṁ − 2C is skew-symmetric. The determinant

    det M = I_φ I_θ I_ψ M² m_c² l⁴ (M+m_c) sin²α

is zero when the pendulum is upright, so (7) cannot be solved for q̈ there. The simulation therefore uses the equations
of `quadpend_gym.physics.dynamics`. ``tests/quadpend_gym/physics/test_lagrangian.py`` derives these matrices with sympy
and compares them.

| symbol       | code name                     | unit         | frame          | shape |
|--------------|-------------------------------|--------------|----------------|-------|
| q            | q                             | m, rad       | world, φ θ ψ   | 8     |
| q̇            | q_dot                         | m/s, rad/s   |                | 8     |
| M(q)         | mass_matrix                   | kg … kg·m²   |                | 8 × 8 |
| C(q, q̇)      | coriolis_matrix               | kg/s …       |                | 8 × 8 |
| G(q)         | gravity_vector                | N, N·m       |                | 8     |
| B(q)         | input_matrix                  | 1            |                | 8 × 4 |
| Θ, Y         | `_coupling`, `_coupling_rate` | kg·m, kg·m/s | world          | 3 × 2 |
| r, ∂r/∂(α,β) | `_direction`, `_tangents`     | 1            | world          | 3, 3 × 2 |

Errors in the paper that are corrected here:

| entry   | printed                                      | corrected                                   |
|---------|----------------------------------------------|---------------------------------------------|
| Θ₃₁     | +Sα                                          | −Sα                                         |
| Γᵀ₂₁    | −Cα Sβ                                       | +Cα Sβ, so that Γ = Θᵀ                      |
| Y row 1 | −(α̇Sα + β̇CαSβ), −(α̇CαCβ + β̇Sα)              | −(α̇SαCβ + β̇CαSβ), −(α̇CαSβ + β̇SαCβ)         |
| Y row 2 | −(α̇Sα + β̇CαCβ), −(α̇CαCβ + β̇Sα)              | −α̇SαSβ + β̇CαCβ, α̇CαCβ − β̇SαSβ              |
| Ψ row 2 | β̇SαCβ, α̇SαCβ                                 | β̇SαCα, α̇SαCα                                |
| u       | [f τ 0 0]ᵀ in R⁸                             | [u τφ τθ τψ]ᵀ in R⁴, since B is 8 × 4       |
"""

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_SIZE, COMMAND_TORQUE, STATE_SIZE, THRUST, State
from quadpend_gym.vehicles import Parameters

_POSITION, _EULER, _ANGLES = slice(0, 3), slice(3, 6), slice(6, 8)
_SIZE = 8


def _direction(q: Floats) -> Floats:
    alpha, beta = q[_ANGLES]
    return np.array([np.sin(alpha) * np.cos(beta), np.sin(alpha) * np.sin(beta), np.cos(alpha)])


def _tangents(q: Floats) -> Floats:
    alpha, beta = q[_ANGLES]
    sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    return np.array([[ca * cb, -sa * sb], [ca * sb, sa * cb], [-sa, 0.0]])


def _coupling(q: Floats, parameters: Parameters) -> Floats:
    return parameters.bob_mass * parameters.rod_length * _tangents(q)


def _coupling_rate(q: Floats, q_dot: Floats, parameters: Parameters) -> Floats:
    alpha, beta = q[_ANGLES]
    alpha_dot, beta_dot = q_dot[_ANGLES]
    sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    entries = [
        [-alpha_dot * sa * cb - beta_dot * ca * sb, -alpha_dot * ca * sb - beta_dot * sa * cb],
        [-alpha_dot * sa * sb + beta_dot * ca * cb, alpha_dot * ca * cb - beta_dot * sa * sb],
        [-alpha_dot * ca, 0.0],
    ]
    return parameters.bob_mass * parameters.rod_length * np.array(entries)


def mass_matrix(q: Floats, parameters: Parameters) -> Floats:
    """Return M(q) of equation (7), symmetric, and positive definite except at sin α = 0, where it is singular."""
    p = parameters
    alpha, _ = q[_ANGLES]
    matrix = np.zeros((_SIZE, _SIZE))
    matrix[_POSITION, _POSITION] = p.total_mass * np.eye(3)
    matrix[_EULER, _EULER] = np.diag([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    matrix[_POSITION, _ANGLES] = _coupling(q, p)
    matrix[_ANGLES, _POSITION] = _coupling(q, p).T
    matrix[_ANGLES, _ANGLES] = p.bob_mass * p.rod_length**2 * np.diag([1.0, np.sin(alpha) ** 2])
    return matrix


def coriolis_matrix(q: Floats, q_dot: Floats, parameters: Parameters) -> Floats:
    """Return C(q, q̇) of equation (7), which consists of Christoffel symbols."""
    p = parameters
    alpha, _ = q[_ANGLES]
    alpha_dot, beta_dot = q_dot[_ANGLES]
    swing = np.array([[0.0, -beta_dot], [beta_dot, alpha_dot]])
    matrix = np.zeros((_SIZE, _SIZE))
    matrix[_POSITION, _ANGLES] = _coupling_rate(q, q_dot, p)
    matrix[_ANGLES, _ANGLES] = p.bob_mass * p.rod_length**2 * np.sin(alpha) * np.cos(alpha) * swing
    return matrix


def gravity_vector(q: Floats, parameters: Parameters) -> Floats:
    """Return G(q) of equation (7), the gradient of the potential energy."""
    p = parameters
    alpha, _ = q[_ANGLES]
    vector = np.zeros(_SIZE)
    vector[_POSITION] = 0.0, 0.0, p.hover_thrust
    vector[_ANGLES] = -p.bob_mass * p.gravity * p.rod_length * np.sin(alpha), 0.0
    return vector


def input_matrix(q: Floats) -> Floats:
    """Return B(q) of equation (7): the thrust acts on the position along R e₃, the torques on the Euler angles."""
    (s_roll, s_pitch, s_yaw), (c_roll, c_pitch, c_yaw) = np.sin(q[_EULER]), np.cos(q[_EULER])
    matrix = np.zeros((_SIZE, COMMAND_SIZE))
    matrix[_POSITION, THRUST] = (
        c_yaw * s_pitch * c_roll + s_yaw * s_roll,
        s_yaw * s_pitch * c_roll - c_yaw * s_roll,
        c_pitch * c_roll,
    )
    matrix[_EULER, COMMAND_TORQUE:] = np.eye(3)
    return matrix


def state_from_coordinates(q: Floats, q_dot: Floats) -> Floats:
    """Convert the coordinates q and rates q̇, each of shape (8,), to a state array of shape (18,), see `State`."""
    state = State(np.empty(STATE_SIZE))
    state.position[:], state.velocity[:] = q[_POSITION], q_dot[_POSITION]
    state.euler[:], state.euler_rate[:] = q[_EULER], q_dot[_EULER]
    state.direction[:], state.direction_rate[:] = _direction(q), _tangents(q) @ q_dot[_ANGLES]
    return state.array
