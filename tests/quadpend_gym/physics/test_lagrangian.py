"""The equations of motion agree with those that sympy derives here from the paper's energies (1)–(5)."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import (
    COMMAND_SIZE,
    COMMAND_TORQUE,
    DISTURBANCE_FIELDS,
    DISTURBANCE_SIZE,
    STATE_SIZE,
    THRUST,
    State,
)
from quadpend_gym.vehicles import Parameters
from tests.helpers.invariants import energy, momentum
from tests.helpers.lagrangian import (
    coriolis_matrix,
    gravity_vector,
    input_matrix,
    mass_matrix,
    state_from_coordinates,
)
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances


@pytest.fixture(scope="module")
def derived() -> SimpleNamespace:
    """Return functions of (q, q̇, q̈, u τ, d_Q d_B d_τ, parameters) that sympy derives from the energies."""
    q, q_dot, q_ddot = (sp.Matrix(sp.symbols(f"{name}:8")) for name in ("q", "v", "a"))
    command, disturbance = sp.Matrix(sp.symbols(f"u:{COMMAND_SIZE}")), sp.Matrix(sp.symbols(f"d:{DISTURBANCE_SIZE}"))
    parameters = sp.Matrix(sp.symbols("M m_c l g I_phi I_theta I_psi", positive=True))
    M, m_c, length, g, *inertia = parameters

    def rate(vector: sp.Matrix) -> sp.Matrix:
        return vector.jacobian(q) * q_dot + vector.jacobian(q_dot) * q_ddot

    alpha, beta = q[6], q[7]
    quadrotor, euler = q[0:3, :], q[3:6, :]
    direction = sp.Matrix([sp.sin(alpha) * sp.cos(beta), sp.sin(alpha) * sp.sin(beta), sp.cos(alpha)])
    bob = quadrotor + length * direction

    velocities = (rate(quadrotor), rate(bob), rate(euler))
    inertias = (M * sp.eye(3), m_c * sp.eye(3), sp.diag(*inertia))
    kinetic = sum(((v.T * j * v)[0] for v, j in zip(velocities, inertias, strict=True)), sp.Integer(0)) / 2
    potential = M * g * quadrotor[2] + m_c * g * bob[2]
    lagrangian = sp.Matrix([kinetic - potential])

    momentum = lagrangian.jacobian(q_dot).T
    euler_lagrange = rate(momentum) - lagrangian.jacobian(q).T
    mass = momentum.jacobian(q_dot)

    rotations = (sp.rot_ccw_axis3(euler[2]), sp.rot_ccw_axis2(euler[1]), sp.rot_ccw_axis1(euler[0]))
    thrust_axis = rotations[0] * rotations[1] * rotations[2] * sp.Matrix([0, 0, 1])
    force = command[THRUST] * thrust_axis + disturbance[DISTURBANCE_FIELDS["force"], :]
    torque = command[COMMAND_TORQUE:, :] + disturbance[DISTURBANCE_FIELDS["torque"], :]
    bob_force = disturbance[DISTURBANCE_FIELDS["bob_force"], :]
    # Virtual work: each force acts along the virtual displacement of its point of application.
    generalised = quadrotor.jacobian(q).T * force + bob.jacobian(q).T * bob_force + euler.jacobian(q).T * torque

    arguments = [list(v) for v in (q, q_dot, q_ddot, command, disturbance, parameters)]

    def function(expression: sp.Matrix) -> Callable[..., Floats]:
        compiled: Callable[..., Floats] = sp.lambdify(arguments, expression, "numpy", cse=True)
        return compiled

    mass_rate = mass.applyfunc(lambda entry: rate(sp.Matrix([entry]))[0])
    curl = momentum.jacobian(q) - momentum.jacobian(q).T
    return SimpleNamespace(
        mass=function(mass),
        mass_rate=function(mass_rate),
        christoffel=function((mass_rate + curl) / 2),
        bias=function(euler_lagrange.subs(dict.fromkeys(q_ddot, 0))),
        gravity=function(sp.Matrix([potential]).jacobian(q).T),
        generalised=function(generalised),
        inputs=function(generalised.jacobian(command)),
        direction_acceleration=function(rate(rate(direction))),
        energy=function(sp.Matrix([kinetic + potential])),
        momentum=function(momentum),
    )


@dataclass(frozen=True)
class Sample:
    """Random coordinates, inputs and forces; the pendulum is at least 0.1 rad from upright and from hanging."""

    q: Floats
    q_dot: Floats
    command: Floats
    disturbance: Floats
    parameters: Parameters = UNEQUAL

    def arguments(self, q_ddot: Floats | None = None) -> tuple[Floats, ...]:
        """Return the arguments of the derived functions."""
        q_ddot = np.zeros(8) if q_ddot is None else q_ddot
        parameters = self.parameters.as_array()[:7]  # the Lagrangian has no drag
        return self.q, self.q_dot, q_ddot, self.command, self.disturbance, parameters


def sample(seed: int) -> Sample:
    """Draw the sample of a seed."""
    rng = np.random.default_rng([3, seed])
    q, q_dot = rng.normal(size=(2, 8))
    q[3:6] = rng.uniform(-np.pi, np.pi, 3)
    q[6:8] = rng.uniform(0.1, np.pi - 0.1), rng.uniform(-np.pi, np.pi)
    return Sample(q, 3.0 * q_dot, random_commands(1, seed, UNEQUAL)[0], random_disturbances(1, seed)[0])


@pytest.mark.parametrize("seed", range(40))
def test_accelerations_solve_the_euler_lagrange_equations(derived: SimpleNamespace, seed: int) -> None:
    given = sample(seed)
    arguments = given.arguments()
    q_ddot = np.linalg.solve(
        derived.mass(*arguments), (derived.generalised(*arguments) - derived.bias(*arguments))[:, 0]
    )
    expected = {
        "position": q_ddot[0:3],
        "euler": q_ddot[3:6],
        "direction": derived.direction_acceleration(*given.arguments(q_ddot))[:, 0],
    }
    actual = accelerations(
        state_from_coordinates(given.q, given.q_dot), given.command, given.disturbance, given.parameters
    )
    for name, value in expected.items():
        assert_allclose(getattr(actual, name), value, rtol=0.0, atol=1e-9 * float(np.linalg.norm(value)), err_msg=name)


@pytest.mark.parametrize("seed", range(10))
def test_energy_and_momentum_are_those_of_the_lagrangian(derived: SimpleNamespace, seed: int) -> None:
    given = sample(seed)
    state, arguments = state_from_coordinates(given.q, given.q_dot), given.arguments()
    assert_allclose(energy(state, given.parameters), derived.energy(*arguments)[0, 0], rtol=1e-12)
    assert_allclose(momentum(state, given.parameters), derived.momentum(*arguments)[0:3, 0], rtol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_the_corrected_matrices_are_the_derived_ones(derived: SimpleNamespace, seed: int) -> None:
    given = sample(seed)
    q, q_dot, parameters, arguments = given.q, given.q_dot, given.parameters, given.arguments()
    pairs = {
        "M": (mass_matrix(q, parameters), derived.mass(*arguments)),
        "C": (coriolis_matrix(q, q_dot, parameters), derived.christoffel(*arguments)),
        "G": (gravity_vector(q, parameters), derived.gravity(*arguments)[:, 0]),
        "B": (input_matrix(q), derived.inputs(*arguments)),
    }
    for name, (actual, expected) in pairs.items():
        assert_allclose(actual, expected, rtol=1e-12, atol=1e-12, err_msg=name)
    bias = coriolis_matrix(q, q_dot, parameters) @ q_dot + gravity_vector(q, parameters)
    assert_allclose(bias, derived.bias(*arguments)[:, 0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_mass_rate_minus_twice_coriolis_is_skew_symmetric(derived: SimpleNamespace, seed: int) -> None:
    given = sample(seed)
    skew = derived.mass_rate(*given.arguments()) - 2.0 * coriolis_matrix(given.q, given.q_dot, given.parameters)
    assert_allclose(skew, -skew.T, rtol=0.0, atol=1e-12)


def hover(parameters: Parameters) -> tuple[Floats, Floats]:
    """Return the state and the command of hovering with the pendulum upright."""
    state = np.zeros(STATE_SIZE)
    State(state).direction[:] = 0.0, 0.0, 1.0
    command = np.zeros(COMMAND_SIZE)
    command[THRUST] = parameters.hover_thrust
    return state, command


def test_hover_is_an_equilibrium() -> None:
    state, command = hover(UNEQUAL)
    at_hover = accelerations(state, command, np.zeros(DISTURBANCE_SIZE), UNEQUAL)
    for name in ("position", "euler", "direction"):
        assert_allclose(getattr(at_hover, name), 0.0, atol=1e-14, err_msg=name)


def test_linearisation_at_hover_is_the_corrected_one_of_the_paper() -> None:
    """(12) and (24)–(26) are as printed, (27)–(29) have the signs of a right-handed frame, z̈ = u_δ/(M+m_c)."""
    p = UNEQUAL
    M, m_c, g = p.quadrotor_mass, p.bob_mass, p.gravity
    K = p.total_mass * g / (M * p.rod_length)
    assert p.chain_stiffness == pytest.approx(K)
    #    φ                     θ                    ψ   r_x         r_y         u                   τφ τθ τψ
    expected = [
        [0, p.total_mass * g / M, 0, -m_c * g / M, 0, 0, 0, 0, 0],  # ẍ, (24)
        [-p.total_mass * g / M, 0, 0, 0, -m_c * g / M, 0, 0, 0, 0],  # ÿ, (27)
        [0, 0, 0, 0, 0, 1 / p.total_mass, 0, 0, 0],  # z̈
        [0, 0, 0, 0, 0, 0, 1 / p.inertia_roll, 0, 0],  # φ̈, (28)
        [0, 0, 0, 0, 0, 0, 0, 1 / p.inertia_pitch, 0],  # θ̈, (25)
        [0, 0, 0, 0, 0, 0, 0, 0, 1 / p.inertia_yaw],  # ψ̈, (12)
        [0, -K, 0, K, 0, 0, 0, 0, 0],  # r̈_x, (26)
        [K, 0, 0, 0, K, 0, 0, 0, 0],  # r̈_y, (29)
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # r̈_z
    ]

    def response(deviation: Floats) -> Floats:
        state, command = hover(p)
        State(state).euler[:] = deviation[0:3]
        r_x, r_y = deviation[3:5]
        State(state).direction[:] = r_x, r_y, np.sqrt(1.0 - r_x**2 - r_y**2)
        result = accelerations(state, command + deviation[5:9], np.zeros(DISTURBANCE_SIZE), p)
        return np.concatenate([result.position, result.euler, result.direction])

    steps = 1e-5 * np.eye(9)
    jacobian = np.transpose([(response(step) - response(-step)) / 2e-5 for step in steps])
    assert_allclose(jacobian, np.array(expected), rtol=0.0, atol=1e-7)
