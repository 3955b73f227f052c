"""How exact the simulation is, and how often intervals and tests are right.

`make accuracy` runs this file as ``python -m benchmarks.accuracy`` and updates docs/accuracy.md. Everything is
simulated from fixed seeds, so the numbers are the same in every run on the same kind of machine.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.pages import DOCS, fill
from quadpend_gym import QuadPendulumEnv
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_SIZE, THRUST, State
from quadpend_gym.vehicles import CONTROL_PERIOD, PAPER, VEHICLES, Simulation, Vehicle, torque_limits
from quadpend_gym.vehicles.parts import Drag
from quadpend_train.evaluation import statistics
from quadpend_train.evaluation.formatting import markdown_table
from tests.helpers.envs import AT_REST, ENDLESS
from tests.helpers.mujoco_engine import position_errors
from tests.helpers.physics import UNEQUAL, random_states, simulate_period
from tests.helpers.rigid_mujoco import Comparison, rigid_position_errors

EPISODE_STEPS, DRIFT_STEPS = 1000, 1_000_000
PERIODS = (0.005, 0.01, 0.02, 0.04)  # s
SUBSTEPS = [1, 2, 4, 10, 20]
SEEDS, RIGID_SEEDS, SECONDS = range(10), range(5), 2.0  # of the flights that are compared with MuJoCo
TIMESTEP = 1e-4  # s, of MuJoCo
BODIES = {
    "unequal": UNEQUAL,
    "paper": PAPER,
    "rod of 0.1 m, bob of 0.5 kg": PAPER._replace(rod_length=0.1, bob_mass=0.5),
    "rod of 1 m": PAPER._replace(rod_length=1.0),
    "bob of 0.02 kg": PAPER._replace(bob_mass=0.02),
}
RIGID_VEHICLES = ("hummingbird", "crazyflie", "skydio-x2")
SHOWN, SHOWN_PERIODS = ("paper", *RIGID_VEHICLES), (0.01, 0.02)  # of the tables of the page
DRAG_PERIODS, DRAG_SECONDS = (0.02, 0.01, 0.005, 0.0025), 0.5  # s
_FINE = 50  # The error of a flight with drag is its distance from one with so many times shorter control periods.
TURNS = (0.05, 0.1, 0.2, 0.4, 0.8, np.inf)  # rad: limits of the angle by which the pendulum turns in a substep
SIZES = (10, 20, 50, 200)
TRIALS = 2000
FAMILY, FAMILY_TRIALS = 16, 1000  # scenarios of a comparison, and simulated comparisons

RARE = "mean, 1 % falls"

Draw = Callable[[np.random.Generator, tuple[int, ...]], Any]  # values of a shape
Sample = Callable[[np.random.Generator, int], Any]  # values of n episodes


def _with_falls(random: np.random.Generator, shape: tuple[int, ...], share: float = 0.05) -> Any:
    return np.where(random.random(shape) < share, 1.0, random.gamma(4.0, 0.005, shape))


DRAWS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda random, shape: random.normal(0.0, 1.0, shape), 0.0),
    "exponential": (lambda random, shape: random.exponential(1.0, shape), 1.0),
    "lognormal": (lambda random, shape: random.lognormal(0.0, 1.0, shape), float(np.exp(0.5))),
    "5 % falls": (_with_falls, 0.05 + 0.95 * 0.02),
}


def energy_drift(steps: int) -> tuple[float, float, float]:
    """Return mean |E| of the pendulum relative to the quadrotor, its largest drift in an episode and in `steps`, J.

    At constant hover thrust without a disturbance E = ½ μ l² |ṙ|² + μ l (u / m_q) r_z is constant, with the reduced
    mass μ = m_q m_c / (m_q + m_c). Some of the pendulums turn over, the others swing.
    """
    p, rows = UNEQUAL, 64
    reduced = p.quadrotor_mass * p.bob_mass / (p.quadrotor_mass + p.bob_mass)
    states = np.zeros((rows, STATE_SIZE))
    start, drawn = State(states), State(random_states(rows, 0))
    start.direction[:], start.direction_rate[:] = drawn.direction, drawn.direction_rate
    command, disturbance = np.zeros(COMMAND_SIZE), np.zeros(DISTURBANCE_SIZE)
    command[THRUST] = p.hover_thrust

    def energy(states: Any) -> Any:
        s = State(states)
        kinetic = 0.5 * p.rod_length * np.sum(s.direction_rate**2, axis=-1)
        return reduced * p.rod_length * (kinetic + p.hover_thrust / p.quadrotor_mass * s.direction[:, 2])

    first, episode, largest = energy(states), 0.0, 0.0
    for step in range(steps):
        states = simulate_period(states, command, disturbance, p, CONTROL_PERIOD, Simulation().substeps)
        if step < EPISODE_STEPS or step % EPISODE_STEPS == EPISODE_STEPS - 1:
            largest = max(largest, float(np.abs(energy(states) - first).max()))
        if step < EPISODE_STEPS:
            episode = largest
    return float(np.abs(first).mean()), episode, largest


def rigid_comparison(vehicle: Vehicle, seed: int, period: float) -> Comparison:
    """Compare a flight of a vehicle without drag; standard deviations of the disturbances follow from its weight."""
    pole = replace(vehicle.pole, drag_area=0.0)
    force, bob_force = 0.1 * vehicle.weight, 0.5 * pole.mass * vehicle.gravity
    forces = np.repeat([force, bob_force, 0.1 * torque_limits(vehicle)[0]], 3)
    free = replace(vehicle, pole=pole, drag=Drag())
    return rigid_position_errors(free, seed, SECONDS, period, SUBSTEPS, TIMESTEP, forces)


def mujoco_table(flights: dict[tuple[str, float], list[Comparison]]) -> str:
    """Return a Markdown table with the largest distance from MuJoCo, mm, by body, control period and substeps."""
    rows = []
    for (name, period), runs in flights.items():
        worst = [1000.0 * max(run.errors[number] for run in runs) for number in SUBSTEPS]
        rate = max(run.rate for run in runs)
        rows.append([name, f"{1000.0 * period:g} ms", f"{rate:.0f} rad/s", *(f"{value:.1e}" for value in worst)])
    substeps = [f"{number} substep{'s' if number > 1 else ''}" for number in SUBSTEPS]
    return markdown_table(["body", "control period", "rate", *substeps], rows)


def drag_table() -> str:
    """Return a Markdown table of the error of flights in still air, and of one without drag, mm."""
    rows = []
    for name in SHOWN:
        vehicle = VEHICLES[name]
        errors = [f"{drag_error(vehicle, period):.2g}" for period in DRAG_PERIODS]
        free = replace(vehicle, drag=Drag(), pole=replace(vehicle.pole, drag_area=0.0))
        rows.append([name, *errors, f"{drag_error(free, CONTROL_PERIOD):.1e}"])
    periods = [f"{1000.0 * period:g} ms" for period in DRAG_PERIODS]
    return markdown_table(["vehicle", *periods, f"{1000.0 * CONTROL_PERIOD:g} ms without drag"], rows)


def drag_error(vehicle: Vehicle, period: float) -> float:
    """Return the error of the position after half a second with constant rotors, from 5 m/s, mm."""
    ends = []
    for length in (period, period / _FINE):
        env = QuadPendulumEnv(vehicle=vehicle, wind="still_air", period=length, task=ENDLESS)
        env.reset(seed=0, options={"state": {**AT_REST, "velocity": (4.0, 3.0, 0.0), "direction": (0.1, 0.0, 1.0)}})
        for _ in range(round(DRAG_SECONDS / length)):
            env.step(np.zeros(4, np.float32))
        ends.append(env.state.position.copy())
    return float(1000.0 * np.linalg.norm(ends[0] - ends[1]))


def rule_table(flights: dict[tuple[str, float], list[Comparison]]) -> str:
    """Return a Markdown table with errors by the largest angle of the pendulum in a substep, relative to the rod."""
    found = []
    for (name, period), runs in flights.items():
        for errors, rate in runs:
            for number, error in errors.items():
                halved = errors.get(2 * number, np.nan)
                found.append((period / number * rate, error / BODIES[name].rod_length, error / halved))
    points = pd.DataFrame(found, columns=["turn", "error", "gain"])
    rows = []
    turns: Any
    for turns, group in points.groupby(pd.cut(points.turn, (0.0, *TURNS)), observed=True):
        label = f"{turns.left:g} to {turns.right:g}" if np.isfinite(turns.right) else f"above {turns.left:g}"
        gain = "–" if group.gain.isna().all() else f"{group.gain.median():.0f}"
        rows.append([label, f"{len(group)}", f"{group.error.median():.0e}", f"{group.error.max():.0e}", gain])
    headings = ["h Ω", "simulations", "median error / l", "largest error / l", "error with h : error with h/2"]
    return markdown_table(headings, rows)


def _one_seed(draw: Draw) -> Sample:
    return lambda random, n: draw(random, (1, n))


def _survivals(share: float) -> Sample:
    return lambda random, n: random.random((1, n)) < share


def _two_policies(random: np.random.Generator, n: int) -> Any:
    return _survivals(0.95)(random, n), _survivals(0.9)(random, n)


def _training_seeds(seeds: int, effect: Callable[..., Any] = np.random.Generator.normal, mean: float = 0.0) -> Sample:
    """Draw effects of seeds, effects of episodes and a residual."""

    def draw(random: np.random.Generator, n: int) -> Any:
        effects = effect(random, size=(seeds, 1)) - mean + random.normal(size=(1, n))
        return effects + random.normal(size=(seeds, n))

    return draw


def coverage_table() -> str:
    """Return a Markdown table with the coverage in % of every 95 % interval by the number of episodes."""
    mean = statistics.mean
    rare = _one_seed(partial(_with_falls, share=0.01))
    cases: list[tuple[str, Any, Sample, float]] = [
        *((f"mean, {name}", mean, _one_seed(draw), true) for name, (draw, true) in DRAWS.items()),
        (RARE, mean, rare, 0.01 + 0.99 * 0.02),
        *((f"survival of {100 * p:g} %", statistics.proportion, _survivals(p), p) for p in (0.9, 0.99)),
        ("loss of survival, 95 % against 90 %, bound", _loss, _two_policies, -0.05),
        *((f"mean over {n} training seeds, normal", mean, _training_seeds(n), 0.0) for n in (2, 5)),
    ]
    shared, own, rows = np.random.default_rng(1), np.random.default_rng(3), []
    for name, estimate, draw, truth in cases:
        random = own if name == RARE else shared
        found = [[estimate(draw(random, n)) for _ in range(TRIALS)] for n in SIZES]
        rows.append([name, *(f"{100.0 * np.mean([x.low <= truth <= x.high for x in row]):.1f}" for row in found)])
    return _without_smallest("interval", rows)


def _without_smallest(heading: str, rows: list[list[str]]) -> str:
    """Return a Markdown table without the column of the smallest of `SIZES`, which only keeps the random numbers."""
    return markdown_table([heading, *(f"{n} episodes" for n in SIZES[1:])], [[row[0], *row[2:]] for row in rows])


def _loss(survived: Any) -> Any:
    return statistics.Interval(np.nan, -1.0, statistics.largest_loss(*survived))


def error_table() -> str:
    """Return a Markdown table with the share in % of true hypotheses that the tests reject at the 5 % level."""
    random, p_value = np.random.default_rng(2), statistics.p_value
    cases: dict[str, Callable[[int], float]] = {
        f"RMSE, both {name}": partial(lambda draw, n: p_value(draw(random, (1, n)) - draw(random, (1, n))), draw)
        for name, (draw, _) in DRAWS.items()
    }
    cases["survival, both 95 %"] = lambda n: statistics.p_proportion(*(_survivals(0.95)(random, n) for _ in range(2)))
    cases["RMSE, five training seeds"] = lambda n: p_value(_training_seeds(5)(random, n))
    for name in ("exponential", "lognormal"):
        shifted = partial(lambda draw, mean, n: p_value(draw(random, (1, n)) - mean), *DRAWS[name])
        cases[f"RMSE, {name} differences with mean zero"] = shifted
    skewed = _training_seeds(5, np.random.Generator.exponential, 1.0)
    cases["RMSE, five training seeds with exponential effects"] = lambda n: p_value(skewed(random, n))
    cases[f"any of {FAMILY} scenarios, corrected"] = partial(_family, random)
    rows = []
    for name, p in cases.items():
        number = FAMILY_TRIALS if name.startswith("any") else TRIALS
        rows.append([name, *(f"{100.0 * np.mean([p(n) < 0.05 for _ in range(number)]):.1f}" for n in SIZES)])
    return _without_smallest("hypothesis", rows)


def _family(random: np.random.Generator, episodes: int) -> float:
    """Return the smallest corrected p-value of two equal policies in all scenarios, by survival and by RMSE."""
    p_values = []
    for _ in range(FAMILY):
        survived = random.random((2, 1, episodes)) < 0.95
        differences = random.gamma(4.0, 0.005, (1, episodes)) - random.gamma(4.0, 0.005, (1, episodes))
        both = survived[0] & survived[1]
        p_values += [statistics.p_proportion(*survived), statistics.p_value(np.where(both, differences, np.nan))]
    return min(statistics.holm(p_values))


def main() -> None:
    """Measure, print, and update the page."""
    argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__).parse_args()
    energy, episode, largest = energy_drift(DRIFT_STEPS)
    drift = [
        [r"mean of \|E\|", f"{energy:.2g} J"],
        ["largest drift in an episode of 1000 steps", f"{episode:.1e} J"],
        [f"largest drift in {DRIFT_STEPS:,} steps", f"{largest:.1e} J"],
        ["drift for each step", f"{largest / DRIFT_STEPS:.1e} J"],
    ]
    flights = {
        (name, period): [position_errors(parameters, seed, SECONDS, period, SUBSTEPS) for seed in SEEDS]
        for name, parameters in BODIES.items()
        for period in PERIODS
    }
    rigid = {
        (name, period): [rigid_comparison(VEHICLES[name], seed, period) for seed in RIGID_SEEDS]
        for name in RIGID_VEHICLES
        for period in PERIODS
    }
    shown = {key: runs for key, runs in (flights | rigid).items() if key[0] in SHOWN and key[1] in SHOWN_PERIODS}
    parts = {
        "energy": markdown_table(["quantity", "value"], drift),
        "mujoco": mujoco_table(shown),
        "rule": rule_table(flights),
        "drag": drag_table(),
        "coverage": coverage_table(),
        "errors": error_table(),
    }
    fill(DOCS / "accuracy.md", parts)
    print("\n\n".join(parts.values()))


if __name__ == "__main__":
    main()
