"""One Gauss–Newton step of `nmpc`, as a CasADi function.

The plan consists of states X_0 … X_H and commands U_0 … U_{H−1}. One step of sequential quadratic programming (SQP)
linearises the model at each point of the plan, x⁺ ≈ f(X, U) + A δx + B δu, and eliminates the deviations of the states
(condensing):

    (1)  δx_0 = x̂ − X_0,      δx_{k+1} = A_k δx_k + B_k δu_k + f(X_k, U_k) − X_{k+1}
    (2)  δx_k = δ_k + Γ_k δu
    (3)  min over δu of  ½ δuᵀ (Σ Γ_kᵀ W_k Γ_k + diag R) δu + gᵀ δu,      u_min ≤ U + δu ≤ u_max

W_k = J_kᵀ W J_k is the Gauss–Newton approximation of the Hessian, with the Jacobian J_k of the residuals: the deviation
from the reference and the violation of the bounds of tilt. The quadratic program (3) has 4 H variables and no other
constraints than bounds. DAQP, a dual active-set method that CasADi contains, solves it (Arnström, Bemporad & Axehill,
IEEE Transactions on Automatic Control 2022).
"""

from typing import Any

import casadi as ca

from quadpend_baselines.controllers.mppi_kernel import BARRIER, MIN_BODY_COSINE, MIN_PENDULUM_COSINE
from quadpend_baselines.controllers.nmpc_model import period_map
from quadpend_baselines.modelling.linear_model import (
    EULER,
    EULER_RATE,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    POSITION,
    VELOCITY,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_FIELDS, STATE_SIZE


def deviation(state: Any, reference: Any) -> Any:
    """Return x − x_d in the axes of the heading, in the layout of `linear_model`, shape (16, 1)."""
    error = {name: state[part] - reference[part] for name, part in STATE_FIELDS.items()}
    yaw = state[STATE_FIELDS["euler"]][2]
    cosine, sine = ca.cos(yaw), ca.sin(yaw)
    rotation = ca.vertcat(ca.horzcat(cosine, sine), ca.horzcat(-sine, cosine))
    out = ca.SX(MODEL_STATE_SIZE, 1)
    for part, name in ((POSITION, "position"), (VELOCITY, "velocity")):
        out[part] = ca.vertcat(rotation @ error[name][:2], error[name][2])
    out[EULER], out[EULER_RATE] = error["euler"], error["euler_rate"]
    out[PENDULUM], out[PENDULUM_RATE] = rotation @ error["direction"][:2], rotation @ error["direction_rate"][:2]
    return out


def violation(state: Any) -> Any:
    """Return by how much the cosines of the tilt of pendulum and body are below their bounds, shape (2, 1)."""
    roll, pitch, _ = ca.vertsplit(state[STATE_FIELDS["euler"]])
    pendulum = MIN_PENDULUM_COSINE - state[STATE_FIELDS["direction"]][2]
    return ca.fmax(ca.vertcat(pendulum, MIN_BODY_COSINE - ca.cos(roll) * ca.cos(pitch)), 0.0)


def _gauss_newton(state: Any, reference: Any, weight: Floats) -> tuple[Any, Any]:
    """Return J ᵀ W J and Jᵀ W e for the residuals e: deviation and violation."""
    residuals = ca.vertcat(deviation(state, reference), violation(state))
    jacobian = ca.jacobian(residuals, state)
    both = ca.sparsify(ca.diagcat(ca.DM(weight), 2.0 * BARRIER * ca.DM.eye(2)))
    return jacobian.T @ both @ jacobian, jacobian.T @ both @ residuals


def sqp_step(simulation: Simulation, Q: Floats, R: Floats, P: Floats, periods: int) -> Any:
    """Return one SQP step (1)–(3) as a CasADi function.

    Its arguments are the plan X, shape (18, H + 1), and U, shape (4, H); the estimates x̂, shape (18, 1), and d̂, shape
    (9, 1); the reference x_d, shape (18, H + 1), and u_d, shape (4, H); the motion of the reference frame in position
    (m) and velocity (m/s), shape (6, H); and the lowest and highest command, shape (4, 2). It returns the new plan,
    with numbers that are not finite if the quadratic program cannot be solved.

    Args:
        simulation: The model, with the period of the horizon.
        Q: Weights of the state, shape (16, 16), see `lqr.weights`.
        R: Weights of the command, shape (4, 4).
        P: Weights of the last state, shape (16, 16), see `lqr.riccati`.
        periods: H.
    """
    x, u = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", COMMAND_SIZE)
    d, x_d = ca.SX.sym("d", DISTURBANCE_SIZE), ca.SX.sym("x_d", STATE_SIZE)
    y = period_map(simulation)(x, u, d)
    options = {"cse": True}  # eliminates common subexpressions
    linearised = ca.Function("linearised", [x, u, d], [y, ca.jacobian(y, x), ca.jacobian(y, u)], options)
    stage = ca.Function("stage", [x, x_d], _gauss_newton(x, x_d, Q), options)
    terminal = ca.Function("terminal", [x, x_d], _gauss_newton(x, x_d, P), options)

    X, U = ca.MX.sym("X", STATE_SIZE, periods + 1), ca.MX.sym("U", COMMAND_SIZE, periods)
    X_d, U_d = ca.MX.sym("X_d", STATE_SIZE, periods + 1), ca.MX.sym("U_d", COMMAND_SIZE, periods)
    estimate, disturbance = ca.MX.sym("estimate", STATE_SIZE), ca.MX.sym("disturbance", DISTURBANCE_SIZE)
    motions, limits = ca.MX.sym("motions", 6, periods), ca.MX.sym("limits", COMMAND_SIZE, 2)
    size = COMMAND_SIZE * periods
    effort = ca.sparsify(ca.DM(R))
    hessian, gradient = ca.MX(ca.diagcat(*[effort] * periods)), ca.vec(effort @ (U - U_d))
    offsets, responses = [estimate - X[:, 0]], [ca.MX(STATE_SIZE, size)]  # δ_k and Γ_k of equation (2)
    for k in range(periods):
        y, A, B = linearised(X[:, k], U[:, k], disturbance)
        response = A @ responses[k]
        response[:, COMMAND_SIZE * k : COMMAND_SIZE * (k + 1)] = B
        y -= ca.vertcat(motions[:, k], ca.MX(STATE_SIZE - motions.shape[0], 1))
        offset = A @ offsets[k] + y - X[:, k + 1]
        W, g = (stage if k + 1 < periods else terminal)(X[:, k + 1], X_d[:, k + 1])
        hessian += response.T @ (W @ response)
        gradient += response.T @ (W @ offset + g)
        offsets.append(offset)
        responses.append(response)
    problem = {"h": hessian.sparsity(), "a": ca.Sparsity(0, size)}
    solver = ca.conic("solver", "daqp", problem, {"error_on_fail": False})
    lowest, highest = (ca.vec(ca.repmat(limits[:, i], 1, periods) - U) for i in (0, 1))
    change = solver(h=hessian, g=gradient, lbx=lowest, ubx=highest)["x"]
    state_change = [offset + response @ change for offset, response in zip(offsets, responses, strict=True)]
    plan = [X + ca.horzcat(*state_change), U + ca.reshape(change, COMMAND_SIZE, periods)]
    return ca.Function("sqp_step", [X, U, estimate, disturbance, X_d, U_d, motions, limits], plan)
