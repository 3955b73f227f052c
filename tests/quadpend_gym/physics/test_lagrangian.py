"""The equations of motion agree with those that sympy derives from the paper's energies (1)–(5)."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from quadpend_gym.physics.state import COMMAND_TORQUE, Disturbance
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances, rates, state_from_coordinates
from tests.helpers.symbolic import COMMAND, FORCE_ON_BOB, FORCE_ON_QUADROTOR, PARAMETERS, SPHERICAL, derive


@pytest.fixture(scope="module")
def derived() -> Callable[..., Any]:
    """Return a function of (q, q̇, q̈, u τ, d_Q d_B, parameters) that returns M, M q̈ of the inputs, and r̈."""
    model, q_ddot = derive(SPHERICAL), sp.Matrix(sp.symbols("a:8"))
    on_quadrotor, on_bob = model.forces
    force = model.inputs * sp.Matrix(COMMAND) - model.coriolis * model.q_dot - model.gravity
    force += on_quadrotor * sp.Matrix(FORCE_ON_QUADROTOR) + on_bob * sp.Matrix(FORCE_ON_BOB)
    rate = SPHERICAL[1].jacobian(model.q) * model.q_dot
    direction_ddot = rate.jacobian(model.q) * model.q_dot + rate.jacobian(model.q_dot) * q_ddot
    given = model.q, model.q_dot, q_ddot, COMMAND, (*FORCE_ON_QUADROTOR, *FORCE_ON_BOB), PARAMETERS
    outputs = model.mass, force, direction_ddot
    function: Callable[..., Any] = sp.lambdify([list(v) for v in given], outputs, "numpy", cse=True)
    return function


@pytest.mark.parametrize("seed", range(40))
def test_accelerations_solve_the_euler_lagrange_equations(derived: Callable[..., Any], seed: int) -> None:
    """For random coordinates and inputs; the pendulum is at least 0.1 rad from upright and from hanging."""
    rng = np.random.default_rng([3, seed])
    q, q_dot = rng.normal(size=(2, 8))
    q[3:6] = rng.uniform(-np.pi, np.pi, 3)
    q[6:8] = rng.uniform(0.1, np.pi - 0.1), rng.uniform(-np.pi, np.pi)
    q_dot *= 3.0
    command, disturbance = random_commands(1, seed, UNEQUAL)[0], random_disturbances(1, seed)[0]
    whole = command.copy()
    whole[COMMAND_TORQUE:] += Disturbance(disturbance).torque
    inputs = whole, disturbance[:6], UNEQUAL.as_array()[:7]  # the Lagrangian has no drag
    mass, force, _ = derived(q, q_dot, np.zeros(8), *inputs)
    q_ddot = np.linalg.solve(mass, force)[:, 0]
    expected = {"velocity": q_ddot[:3], "euler_rate": q_ddot[3:6]}
    expected["direction_rate"] = derived(q, q_dot, q_ddot, *inputs)[2][:, 0]
    actual = rates(state_from_coordinates(q, q_dot), command, disturbance, UNEQUAL)
    for name, value in expected.items():
        assert_allclose(
            getattr(actual, name)[0], value, rtol=0.0, atol=1e-9 * float(np.linalg.norm(value)), err_msg=name
        )
