"""The equations of motion of rigid vehicles agree with a Lagrangian that sympy differentiates.

The coordinates are position, Euler angles, and the spherical angles of the pole. With the body rate ω(q, q̇), the
direction r(q) and the pole's centre of mass c = ζ + R p + l r, the Lagrangian is

    L = ½ M ζ̇·ζ̇ + ½ ω·I ω + ½ m ċ·ċ + ½ J ṙ·ṙ − M g ζ_z − m g c_z
"""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.vehicles import Simulation, Vehicle
from tests.helpers.physics import random_disturbances, state_from_coordinates
from tests.helpers.rigid import random_vehicle, start
from tests.helpers.rigid_mujoco import command_of
from tests.helpers.symbolic import SPHERICAL, phi, psi, rate_of, theta, x, y, z

E1, E2, E3 = (sp.Matrix(row) for row in np.eye(3, dtype=int).tolist())


@pytest.fixture(scope="module")
def derived() -> SimpleNamespace:
    """Return functions of (q, q̇, q̈, parameters, inputs) that sympy derives from the Lagrangian."""
    angles, direction = SPHERICAL
    q = sp.Matrix([x, y, z, phi, theta, psi, *angles])
    q_dot, q_ddot = q.applyfunc(rate_of), sp.Matrix(sp.symbols("a:8"))
    scalars = M, m, length, g, J = sp.symbols("M m l g J", positive=True)
    inertia, pivot = sp.Matrix(3, 3, sp.symbols("i:9")), sp.Matrix(sp.symbols("p:3"))
    u, *inputs = sp.symbols("u t:12")
    torque, force, bob_force, world_torque = (sp.Matrix(inputs[i : i + 3]) for i in range(0, 12, 3))

    def rate(vector: sp.Matrix) -> sp.Matrix:
        return vector.jacobian(q) * q_dot + vector.jacobian(q_dot) * q_ddot

    roll, pitch, yaw = sp.rot_ccw_axis1(phi), sp.rot_ccw_axis2(theta), sp.rot_ccw_axis3(psi)
    rotation = yaw * pitch * roll
    spin = sp.Matrix.hstack(E1, roll.T * E2, roll.T * pitch.T * E3) * q_dot[3:6, :]
    body = q[0:3, :]
    pole = body + rotation * pivot + length * direction
    kinetic = M * rate(body).dot(rate(body)) + (spin.T * inertia * spin)[0]
    kinetic += m * rate(pole).dot(rate(pole)) + J * rate(direction).dot(rate(direction))
    lagrangian = sp.Matrix([kinetic / 2 - M * g * body[2] - m * g * pole[2]])
    momentum = lagrangian.jacobian(q_dot).T
    # Virtual work: forces act along the displacements of both centres of mass, the torques along the rotation.
    forces = body.jacobian(q).T * (force + u * rotation * E3) + pole.jacobian(q).T * bob_force
    forces += spin.jacobian(q_dot).T * (torque + rotation.T * world_torque)
    bias = momentum.jacobian(q) * q_dot - lagrangian.jacobian(q).T  # the Euler–Lagrange equations without q̈
    arguments = [list(v) for v in (q, q_dot, q_ddot, [*scalars, *inertia, *pivot], [u, *inputs])]
    outputs = {
        "mass": momentum.jacobian(q_dot),
        "forces": forces - bias,
        "body_rate": spin,
        "body_rate_dot": rate(spin),
        "direction_ddot": rate(rate(direction)),
    }
    functions = {name: sp.lambdify(arguments, value, "numpy", cse=True) for name, value in outputs.items()}
    return SimpleNamespace(**functions)


def plain(vehicle: Vehicle) -> list[float]:
    """Return the parameters of the Lagrangian."""
    pole = vehicle.pole
    scalars = [vehicle.mass, pole.mass, pole.length, vehicle.gravity, pole.inertia]
    return [*scalars, *vehicle.inertia_matrix.ravel().tolist(), *vehicle.pivot]


def coordinates(seed: int) -> tuple[Floats, Floats]:
    """Draw coordinates and rates; the pitch is at least 0.1 rad from ±90° and the pole from upright and hanging."""
    rng = np.random.default_rng([6, seed])
    q, q_dot = rng.normal(size=(2, 8))
    q[3:6] = rng.uniform(-1.0, 1.0, 3) * [np.pi, np.pi / 2 - 0.1, np.pi]
    q[6:8] = rng.uniform(0.1, np.pi - 0.1), rng.uniform(-np.pi, np.pi)
    return q, 3.0 * q_dot


@pytest.mark.parametrize("seed", range(20))
def test_accelerations_solve_the_euler_lagrange_equations(derived: SimpleNamespace, seed: int) -> None:
    vehicle, (q, q_dot) = random_vehicle(seed), coordinates(seed)
    simulation, disturbance = Simulation(vehicle=vehicle, period=1e-4, substeps=1), random_disturbances(1, seed)[0]
    action = np.random.default_rng([7, seed]).uniform(-0.5, 0.5, 4)
    flight = start(simulation, state_from_coordinates(q, q_dot))

    given = plain(vehicle), np.concatenate([command_of(action, simulation), disturbance])
    q_ddot = np.linalg.solve(
        derived.mass(q, q_dot, np.zeros(8), *given), derived.forces(q, q_dot, np.zeros(8), *given)
    )[:, 0]
    assert_allclose(flight.body_rate[0], derived.body_rate(q, q_dot, q_ddot, *given)[:, 0], rtol=0.0, atol=1e-12)
    state, memory = flight.rates(action, disturbance)
    for value, expected in (
        (state.velocity, q_ddot[:3]),
        (memory[:, BODY_RATE:ROTOR_THRUST], derived.body_rate_dot(q, q_dot, q_ddot, *given)[:, 0]),
        (state.direction_rate, derived.direction_ddot(q, q_dot, q_ddot, *given)[:, 0]),
    ):
        assert_allclose(value[0], expected, rtol=0.0, atol=1e-9 * float(np.linalg.norm(expected)))
