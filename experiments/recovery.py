"""The recovery in docs/flight.md: from how far policies catch a falling pole, and from how far a plan does.

    python -m experiments.recovery      # 200 episodes from each start, seeds from 1000000; minutes on one core

A plan knows everything. It is a solution by direct multiple shooting and IPOPT of

    (1)  maximise    α − ρ Σ_k |a_k − a_{k−1}|²
    (2)  subject to  x_0 at rest, with the pole at α, after the latency under the hover action;   x_{k+1} = f(x_k, a_k);
                     x_N upright at rest
    (3)              −1 ≤ a_k ≤ 1,   commanded thrusts of the rotors within their limits in every substep,
                     body within its limit of tilt,   |e_k| ≤ the limit of the tracking error

f is a control step of the vehicle, with rate loop, rotor lags and drag, without noise and wind, in the vertical plane
between two arms. Without (3) the rotors would have no limits in f, which is therefore smooth; with (3) it is the step
of the environment, in which the script flies the plan. A solution is a local optimum, so it is no bound.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from experiments.pages import CACHE, DOCS, fill, made_by, options, training_seeds
from quadpend_baselines import controller
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.nested import changed
from quadpend_gym.engines import columns, lift
from quadpend_gym.engines.functions import plant_lanes
from quadpend_gym.engines.lifting import vector
from quadpend_gym.physics.plant_kernel import LANE_STATE_SIZE
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import nominal_loop
from quadpend_gym.physics.rotors import allocate
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_SIZE
from quadpend_gym.physics.vectors import multiply
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.formatting import markdown_table

POLICIES = "lqg", "dual-mode", "flatness", "apg-flight"
ANGLES = 20, 30, 38, 40, 42  # °
BASE = "flight_recovery_30"
STEPS, LATE = 200, 2  # N, 2 s, and the latency in control steps
SMOOTHNESS = 1e-5  # ρ
_BODY, _ROTORS = STATE_SIZE, STATE_SIZE + ROTOR_THRUST
# x, z, ẋ, ż, r_x, r_z, ṙ_x, ṙ_z, cos(θ/2), sin(θ/2), ω_y, and the thrusts of the front and the back rotors
_PLANE = [0, 2, 3, 5, 12, 14, 15, 17, _BODY + QUATERNION, _BODY + QUATERNION + 2, _BODY + BODY_RATE + 1]
_PAIRS = (0, 3), (1, 2)  # rotors in front and behind, on both sides of the plane
_COLUMNS = [*_PLANE, *(_ROTORS + pair[0] for pair in _PAIRS)]
_AT_REST = [2, 3, 4, 6, 9, 10]  # what is zero at the end
_HALF = 9  # sin(θ/2)
_OPTIONS: Any = {"print_level": 0, "sb": "yes", "tol": 1e-4, "constr_viol_tol": 1e-8, "max_iter": 300, "mu_init": 1e-2}


class Plan(NamedTuple):
    """A plan of N control steps in the plane."""

    angle: float  # α, rad
    states: Floats  # shape (13, N + 1)
    actions: Floats  # thrust and pitch rate, shape (2, N)


def quiet(scenario: Scenario) -> Scenario:
    """Return a scenario without noise, with its vehicle turned by 45°, so that two arms are beside the x axis."""
    rotors = scenario.vehicle.rotors
    assert rotors is not None
    c = np.sqrt(0.5).item()
    positions: Any = tuple((c * (x - y), c * (x + y), *z) for x, y, *z in rotors.positions)
    turned = replace(rotors, positions=positions)
    return replace(scenario, vehicle=replace(scenario.vehicle, rotors=turned), sensors=(), actuators=())


def planar_step(scenario: Scenario) -> Any:
    """Return f and the commanded thrusts of both pairs of rotors in each substep (N), which have no limits in f."""
    simulation = replace(scenario.simulation, latency=0.0)
    plant, x, a = plant_of(simulation), ca.SX.sym("x", len(_COLUMNS)), ca.SX.sym("a", 2)
    commanded: list[Any] = []

    def unlimited(wrench: Any, rotors: Any) -> Any:
        thrusts = lift(multiply)(rotors.unmixing, wrench)
        commanded.extend(thrusts[pair[0]] for pair in _PAIRS)
        return thrusts

    whole = ca.SX(STATE_SIZE + plant.memory_size, 1)
    whole[_COLUMNS] = x
    for i, pair in enumerate(_PAIRS):
        whole[_ROTORS + pair[1]] = x[len(_PLANE) + i]
    lanes = plant_lanes(simulation, whole[:STATE_SIZE], whole[STATE_SIZE:])
    blowing = columns([0.0] * DISTURBANCE_SIZE), columns([0.0] * 3), columns([0.0] * 4)
    flying = lanes, columns([a[0], 0.0, a[1], 0.0]), columns(nominal_loop(simulation)), *blowing
    vehicle = columns(simulation.parameters.as_array()), plant.settings()
    command = columns([], COMMAND_SIZE)
    lift(plant.kernel.integrate, {allocate: unlimited})(
        *flying, *vehicle, 1, simulation.period, simulation.substeps, command
    )
    own = lanes[LANE_STATE_SIZE : LANE_STATE_SIZE + plant.memory_size]
    after = ca.vertcat(vector(lanes[:STATE_SIZE]), vector(own))[_COLUMNS]
    return ca.Function("planar_step", [x, a], [ca.cse(after), ca.cse(ca.vertcat(*commanded))])


def fly(scenario: Scenario, angle: float, actions: Floats | None = None) -> tuple[Floats, Floats, bool]:
    """Return planar states and actions of a flight from α, and whether it survives.

    Actions are those of a plan, or else those of `flatness`.
    """
    env, law = scenario.make_vec(1, autoreset_mode="NextStep"), controller("flatness").adapt(scenario)
    world: Any = env.unwrapped.world  # type: ignore[attr-defined]
    height = scenario.task.references.height[0]
    start = {"position": (0.0, 0.0, height), "direction": (np.sin(angle), 0.0, np.cos(angle))}
    observation, _ = env.reset(seed=0, options={"state": start})
    states: list[Floats] = []
    flown: list[Floats] = []
    memory, fell = None, False
    while len(flown) < STEPS + LATE + 1 and not fell:
        state = np.hstack([world.state, world.plant_memory])[0][_COLUMNS]
        state[1] -= height
        states.append(state)
        action, memory = law.predict(observation, memory, np.array([not flown]), deterministic=True)
        if actions is not None:
            action = np.zeros((1, 4), np.float32)
            action[0, [0, 2]] = actions[:, len(flown)] if len(flown) < actions.shape[1] else 0.0
        observation, _, terminated, _, _ = env.step(action)
        flown.append(action[0, [0, 2]].astype(np.float64))
        fell = bool(terminated[0])
    return np.array(states).T, np.array(flown).T, not fell


def plan(scenario: Scenario) -> Plan:
    """Return the plan from the largest angle that is found, beginning with a flight of `flatness` from 30°."""
    simulation, limits = scenario.simulation, scenario.task.limits
    step, rotors = planar_step(scenario), scenario.vehicle.rotors
    assert rotors is not None
    states, actions, _ = fly(scenario, np.deg2rad(30.0))
    problem = ca.Opti()
    X, A, angle = problem.variable(len(_COLUMNS), STEPS + 1), problem.variable(2, STEPS), problem.variable()
    x = ca.vertcat(0, 0, 0, 0, ca.sin(angle), ca.cos(angle), 0, 0, 1, 0, 0, *states[-2:, 0])
    for _ in range(LATE):
        x, _ = step(x, ca.DM.zeros(2))
    after, thrusts = step.map(STEPS)(X[:, :-1], A)
    problem.subject_to(X[:, 0] == x)
    problem.subject_to(ca.vec(after - X[:, 1:]) == 0)
    problem.subject_to(X[_AT_REST, -1] == 0)
    problem.subject_to(problem.bounded(-1, ca.vec(A), 1))
    problem.subject_to(problem.bounded(rotors.thrust[0], ca.vec(thrusts), rotors.thrust[1]))
    lean = 0.999 * np.sin(0.5 * limits.body_angle)
    problem.subject_to(problem.bounded(-lean, X[_HALF, 1:], lean))
    error = ca.vertcat(X[0, 1:] + simulation.parameters.rod_length * X[4, 1:], X[1, 1:])
    problem.subject_to((0.997 * limits.tracking_error) ** 2 >= ca.sum1(error**2).T)
    problem.minimize(-angle + SMOOTHNESS * ca.sumsqr(A[:, 1:] - A[:, :-1]))
    problem.set_initial(X, states[:, LATE : LATE + STEPS + 1])
    problem.set_initial(A, actions[:, :STEPS])
    problem.set_initial(angle, np.deg2rad(30.0))
    problem.solver("ipopt", {"print_time": False}, _OPTIONS)
    found: Any = problem.solve()
    return Plan(float(found.value(angle)), np.array(found.value(X)), np.clip(found.value(A), -1.0, 1.0))


def main() -> None:
    """Fly, plan, and write the tables."""
    given = options(__doc__, 200, POLICIES)
    starts = {f"{angle}°": (np.deg2rad(angle).item(),) * 2 for angle in ANGLES}
    scenarios = {
        name: replace(changed(SCENARIOS[BASE], {"task.start.pendulum_angle": ends}), name=name)
        for name, ends in starts.items()
    }
    found = compare([*map(training_seeds, given.policies)], scenarios, given.episodes, given.seed, CACHE, given.jobs)
    scenario = quiet(SCENARIOS[BASE])
    best = plan(scenario)
    flown, _, survives = fly(scenario, best.angle, best.actions)
    rows = []
    for name in starts:
        shares = (found.summaries[name, policy]["survival"].value for policy in found.policies)
        rows.append([name, *(f"{share:.3g}" for share in shares)])
    text = (
        f"The largest start from which a plan was found is {np.rad2deg(best.angle):.1f}°. Flown in the environment"
        f" without noise, it {'survives' if survives else 'falls'}, and ends with the pole"
        f" {np.rad2deg(np.arcsin(abs(flown[4, -1]))):.1f}° from upright."
    )
    table = markdown_table(["start", *(f"{policy} (%)" for policy in found.policies)], rows)
    provenance = made_by("recovery", given.episodes, given.seed)
    fill(DOCS / "flight.md", {"recovery": f"{provenance}\n\n{table}\n\n{text}"})


if __name__ == "__main__":
    main()
