"""The plan of a swing-up: from a hanging pendulum to an upright one by direct multiple shooting, solved by IPOPT.

With the states x_k and the actions a_k of N control steps:

    (1)  minimise    Σ_k |ρ a_k|² + κ Σ_k |X_k|²,        X: position of the centre of mass relative to the reference
    (2)  subject to  x_{k+1} = f(x_k, a_k),   x_0 hanging at rest,   x_N upright at rest at the same place
    (3)              |a_k| ≤ a_max,   |θ_k| ≤ θ_max

The flight stays in the plane of the body's x axis: roll, yaw and the y components are zero. f is one control step of
the environment in calm air, with rotors that follow at once; a rate loop is a first-order lag. a_max < 1 and θ_max
leave room for the feedback. N, κ and the first guess for a rigid vehicle are those of the paper's vehicle, scaled by
the rate √K and the length g/K of its pendulum, see `quadpend_baselines.gains`.

``python -m quadpend_baselines.controllers.swing_up_planner`` computes the plans of the package again and writes their
files.
"""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from quadpend_baselines.controllers.swing_up_plans import PLANS
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines import step_function
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION
from quadpend_gym.physics.state import ACTION_SIZE, STATE_FIELDS, STATE_SIZE
from quadpend_gym.wind import WIND_SIZE

MOST_ACTION, MOST_PITCH = 0.8, np.deg2rad(65.0)  # a_max, θ_max
_EFFORT, _PLACE = 1e-2, 1.0  # ρ² and κ, 1/m² for the paper's vehicle
_MOTION = [0, 2, 3, 5, 12, 14, 15, 17]  # x, z, ẋ, ż, r_x, r_z and their rates
_PITCH, _PITCH_RATE = 7, 10
_HEIGHT = 5  # r_z in the planned columns; the constraints at the end determine it
_EULER = [_PITCH, _PITCH_RATE]
_RIGID = [STATE_SIZE + QUATERNION, STATE_SIZE + QUATERNION + 2, STATE_SIZE + BODY_RATE + 1]  # cos(θ/2), sin(θ/2), ω_y
_ENDS = [0, 1, 2, 3, 4, 6, -2, -1]  # columns that are zero at the end
_RATE = 6.764  # √K of the paper's vehicle, 1/s
_TIME = 10.15  # N T √K
_SMALL = 5e-8  # smaller numbers are written as zero
_OPTIONS: Any = {"print_level": 0, "sb": "yes", "tol": 1e-6, "max_iter": 1000}


def plan_swing_up(simulation: Simulation) -> tuple[Floats, Floats]:
    """Return the states relative to the place, shape (N + 1, 18), and the actions, shape (N, 4), of a swing-up."""
    if simulation.interface == "rotors":
        raise ValueError("a swing-up is planned for the interfaces 'wrench' and 'body_rates', not 'rotors'")
    p, period, is_rigid = simulation.parameters, simulation.period, simulation.vehicle.attitude == "rigid"
    rate = float(np.sqrt(equivalent_model(simulation).parameters.chain_stiffness))
    steps, step = round(_TIME / rate / period), _planar_step(simulation)
    problem = ca.Opti()
    X, A = problem.variable(step.size1_in(0), steps + 1), problem.variable(2, steps)
    problem.subject_to(ca.vec(step.map(steps)(X[:, :-1], A) - X[:, 1:]) == 0)
    problem.subject_to(X[:, 0] == [0.0] * _HEIGHT + [-1.0, 0.0, 0.0] + ([1.0] if is_rigid else []) + [0.0, 0.0])
    problem.subject_to(X[_ENDS, -1] == 0)
    problem.subject_to(X[_HEIGHT, -1] >= 0)
    turning = A[1, :]
    if simulation.interface == "body_rates":  # the rate loop is a lag
        left = np.exp(-period / simulation.vehicle.rate_loop.time_constant)
        turning = (X[-1, 1:] - left * X[-1, :-1]) / (1.0 - left) / simulation.command_scale[2]
    for limited in (ca.vec(A), turning):
        problem.subject_to(problem.bounded(-MOST_ACTION, limited, MOST_ACTION))
    lean = np.sin(0.5 * MOST_PITCH) if is_rigid else MOST_PITCH
    problem.subject_to(problem.bounded(-lean, X[-2, :], lean))
    centre = X[:2, :] + p.bob_mass * p.rod_length / p.total_mass * X[4:6, :]
    place = _PLACE * (rate / _RATE) ** 4
    problem.minimize(_EFFORT * (ca.sumsqr(A[0, :]) + ca.sumsqr(turning)) + place * ca.sumsqr(centre))
    if is_rigid:
        guess, thrust = _scaled_plan(rate, steps)
        half = 0.5 * guess[:, _PITCH]
        attitude = [np.cos(half), np.sin(half), guess[:, _PITCH_RATE]]
        problem.set_initial(X, np.column_stack([guess[:, _MOTION], *attitude]).T)
        problem.set_initial(A[0, :], thrust[:-1])
    else:
        angle = np.pi * (1.0 - np.linspace(0.0, 1.0, steps + 1) ** 2)
        problem.set_initial(X[4, :], np.sin(angle))
        problem.set_initial(X[_HEIGHT, :], np.cos(angle))
    problem.solver("ipopt", {"print_time": False}, _OPTIONS)
    found: Any = problem.solve()
    x, states, actions = np.array(found.value(X)).T, np.zeros((steps + 1, STATE_SIZE)), np.zeros((steps, ACTION_SIZE))
    states[:, _MOTION], states[:, _PITCH_RATE] = x[:, : len(_MOTION)], x[:, -1]
    states[:, _PITCH] = 2.0 * np.arctan2(x[:, -2], x[:, -3]) if is_rigid else x[:, -2]
    actions[:, [0, 2]] = np.array(found.value(ca.vertcat(A[0, :], turning))).T
    return states, actions


def _planar_step(simulation: Simulation) -> Any:
    """Return f for the columns `_MOTION` and those of the attitude, under the actions of thrust and pitch.

    Thrust and torques of rigid vehicles act at once.
    """
    if simulation.vehicle.attitude == "rigid":
        vehicle = replace(simulation.vehicle, rotors=None, torque=simulation.torque_limits)
        simulation = replace(simulation, vehicle=vehicle, interface="wrench")
    step = step_function(replace(simulation, latency=0.0))
    columns = _MOTION + (_RIGID if simulation.vehicle.attitude == "rigid" else _EULER)
    x, a, z = ca.SX.sym("x", len(columns)), ca.SX.sym("a", 2), ca.SX(STATE_SIZE + step.size1_in(1), 1)
    z[columns] = x
    parameters = ca.DM(simulation.parameters.as_array())
    moved = step(z[:STATE_SIZE], z[STATE_SIZE:], ca.vertcat(a[0], 0, a[1], 0), ca.SX(WIND_SIZE, 1), parameters)
    return ca.Function("planar_step", [x, a], [ca.vertcat(*moved)[columns]])


def _scaled_plan(rate: float, steps: int) -> tuple[Floats, Floats]:
    """Return states and thrust actions of the paper's plan, with its time and lengths scaled to the rate √K."""
    paper = np.loadtxt(next(iter(PLANS)), delimiter=",", skiprows=1)
    places = np.linspace(0.0, len(paper) - 1.0, steps + 1)
    plan = np.column_stack([np.interp(places, np.arange(len(paper)), column) for column in paper.T])
    plan[:, :STATE_SIZE] *= (rate / _RATE) ** np.repeat([-2.0, -1.0, 0.0, 1.0, 0.0, 1.0], 3)
    return plan[:, :STATE_SIZE], plan[:, STATE_SIZE]


def plan_as_csv(states: Floats, actions: Floats) -> str:
    """Return a plan as the text of a file of `PLANS`, with seven digits."""
    names = [f"{name}_{axis}" for name in STATE_FIELDS for axis in "xyz"]
    names += [f"action_{i}" for i in range(ACTION_SIZE)]
    rows = np.hstack([states, np.vstack([actions, np.zeros(ACTION_SIZE)])])
    rows[np.abs(rows) < _SMALL] = 0.0
    return "".join(f"{line}\n" for line in (",".join(names), *(",".join(f"{x:.7g}" for x in row) for row in rows)))


if __name__ == "__main__":
    for path, simulation in PLANS.items():
        path.write_text(plan_as_csv(*plan_swing_up(simulation)), encoding="utf-8")
