"""The plan of a swing-up: from a hanging pendulum to an upright one by direct multiple shooting, solved by IPOPT.

With the states x_k and the actions a_k of N control steps:

    (1)  minimise    Σ_k |ρ a_k|² + κ Σ_k |X_k|²,        X: position of the centre of mass relative to the reference
    (2)  subject to  x_{k+1} = f(x_k, a_k),   x_0 hanging at rest,   x_N upright at rest at the same place
    (3)              |a_k| ≤ a_max,   |θ_k| ≤ θ_max

The flight stays in the plane of the body's x axis: roll, yaw and the y components are zero. f is one control step of
the environment in calm air. a_max < 1 and θ_max leave room for the feedback.

``python -m quadpend_baselines.planning.swing_up`` computes the plan of the package again and writes its file.
"""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from quadpend_baselines.controllers.swing_up import PLANS
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.engines import initial_memory, step_function
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, STATE_FIELDS, STATE_SIZE, State
from quadpend_gym.wind import WIND_SIZE

MOST_ACTION, MOST_PITCH = 0.8, np.deg2rad(65.0)  # a_max, θ_max
_EFFORT, _PLACE = 1e-2, 1.0  # ρ² and κ, 1/m²
_PLANAR = [0, 2, 3, 5, 7, 10, 12, 14, 15, 17]  # x, z, θ, r_x, r_z and their rates
_LEAN = STATE_SIZE + QUATERNION + 2  # sin(θ/2) of a rigid vehicle, whose θ is an output
_THRUSTS = range(STATE_SIZE + ROTOR_THRUST, STATE_SIZE + RIGID_SIZE)
_RIGID = [0, 2, 3, 5, 12, 14, 15, 17, STATE_SIZE + QUATERNION, _LEAN, STATE_SIZE + BODY_RATE + 1, *_THRUSTS]
_TIME = 10.15  # N T √K
_SMALL = 5e-8  # smaller numbers are written as zero
_OPTIONS: Any = {"print_level": 0, "sb": "yes", "tol": 1e-6, "max_iter": 1000}


def plan_swing_up(simulation: Simulation) -> tuple[Floats, Floats]:
    """Return the states relative to the place, shape (N + 1, 18), and the actions, shape (N, 4), of a swing-up."""
    if simulation.interface == "rotors":
        raise ValueError("a swing-up is planned for the interfaces 'wrench' and 'body_rates', not 'rotors'")
    step = step_function(replace(simulation, latency=0.0))
    rate = np.sqrt(equivalent_model(simulation).parameters.chain_stiffness)
    steps = round(_TIME / rate / simulation.period)
    start, end = (_rest(side, simulation) for side in (-1.0, 1.0))
    is_rigid = len(start) > STATE_SIZE
    planar = _RIGID if is_rigid else _PLANAR
    problem = ca.Opti()
    X, A = problem.variable(len(start), steps + 1), problem.variable(ACTION_SIZE, steps)
    calm, parameters = ca.DM.zeros(WIND_SIZE, steps), ca.repmat(ca.DM(simulation.parameters.as_array()), 1, steps)
    moved = ca.vertcat(*step.map(steps)(X[:STATE_SIZE, :-1], X[STATE_SIZE:, :-1], A, calm, parameters))
    gaps = moved - X[:, 1:]
    problem.subject_to(ca.vec(gaps[planar, :]) == 0)
    others = [i for i in range(len(start)) if i not in planar]
    problem.subject_to(ca.vec(X[others, :]) == 0)
    problem.subject_to(ca.vec(A[[1, 3], :]) == 0)
    problem.subject_to(X[planar, 0] == start[planar])
    problem.subject_to(X[planar, -1] == end[planar])
    problem.subject_to(problem.bounded(-MOST_ACTION, ca.vec(A[[0, 2], :]), MOST_ACTION))
    lean, most = (X[_LEAN, :], np.sin(0.5 * MOST_PITCH)) if is_rigid else (X[7, :], MOST_PITCH)
    problem.subject_to(problem.bounded(-most, lean, most))
    p = simulation.parameters
    centre = X[[0, 2], :] + p.bob_mass * p.rod_length / p.total_mass * X[[12, 14], :]
    problem.minimize(_EFFORT * ca.sumsqr(A) + _PLACE * ca.sumsqr(centre))
    problem.set_initial(X, ca.repmat(ca.DM(start), 1, steps + 1))
    angle = np.pi * (1.0 - np.linspace(0.0, 1.0, steps + 1) ** 2)
    problem.set_initial(X[12, :], np.sin(angle))
    problem.set_initial(X[14, :], np.cos(angle))
    problem.solver("ipopt", {"print_time": False}, _OPTIONS)
    found: Any = problem.solve()
    states = np.vstack([start[:STATE_SIZE], np.array(found.value(moved[:STATE_SIZE, :])).T])
    return states, np.array(found.value(A)).T


def _rest(side: float, simulation: Simulation) -> Floats:
    """Return state and memory at rest at the origin, shape (18 + k,), upright (1) or hanging (−1)."""
    state = np.zeros((1, STATE_SIZE))
    State(state).direction[:, 2] = side
    return np.concatenate([state, initial_memory(simulation, state)], axis=1)[0]


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
