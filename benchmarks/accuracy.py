"""How exact the simulation is, and how often intervals and tests are right.

`make accuracy` runs this file as ``python -m benchmarks.accuracy`` and updates docs/accuracy.md. Everything is
simulated from fixed seeds, so the numbers are the same in every run on the same kind of machine.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.physics.parameters import CONTROL_PERIOD, Simulation
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_SIZE, THRUST, State
from quadpend_train.common.documents import fill
from quadpend_train.evaluation import statistics
from quadpend_train.evaluation.formatting import markdown_table
from tests.helpers.mujoco_engine import position_errors
from tests.helpers.physics import UNEQUAL, random_states, simulate_period

EPISODE_STEPS = 1000
PERIODS = (0.005, 0.01, 0.02, 0.04)  # s
SUBSTEPS = [1, 2, 4, 10, 20]
MUJOCO_SEEDS, MUJOCO_SECONDS = range(3), 2.0
SIZES = (10, 20, 50, 200)
TRIALS = 2000
SLOW_TRIALS = 500  # of the interquartile mean
FAMILY, FAMILY_TRIALS = 16, 1000  # scenarios of a comparison, and simulated comparisons

Draw = Callable[[np.random.Generator, tuple[int, ...]], Any]


class Population(NamedTuple):
    """A distribution of values of an episode.

    Attributes:
        draw: Draws values of a shape.
        mean: Mean of the distribution.
        middle: Interquartile mean of the distribution.
    """

    draw: Draw
    mean: float
    middle: float


def _with_falls(random: np.random.Generator, shape: tuple[int, ...]) -> Any:
    return np.where(random.random(shape) < 0.05, 1.0, random.gamma(4.0, 0.005, shape))


def _interquartile_mean(draw: Draw) -> float:
    values = np.sort(draw(np.random.default_rng(0), (4_000_000,)))
    return float(values[1_000_000:3_000_000].mean())


DRAWS: dict[str, tuple[Draw, float]] = {
    "normal": (lambda random, shape: random.normal(0.0, 1.0, shape), 0.0),
    "exponential": (lambda random, shape: random.exponential(1.0, shape), 1.0),
    "lognormal": (lambda random, shape: random.lognormal(0.0, 1.0, shape), float(np.exp(0.5))),
    "5 % falls": (_with_falls, 0.05 + 0.95 * 0.02),
}


def populations() -> dict[str, Population]:
    """Return the populations from which values are drawn, by name."""
    return {name: Population(draw, mean, _interquartile_mean(draw)) for name, (draw, mean) in DRAWS.items()}


def energy_drift(steps: int) -> tuple[float, float, float]:
    """Return the energy of the pendulum relative to the quadrotor, and its largest drift in an episode and in `steps`.

    At constant hover thrust without a disturbance E = ½ μ l² |ṙ|² + μ l (u / m_q) r_z is constant, with the reduced
    mass μ = m_q m_c / (m_q + m_c). Some of the pendulums turn over, the others swing.

    Args:
        steps: Number of control periods.

    Returns:
        Mean |E| of the starts, largest drift within an episode, largest drift within `steps`, J.
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


def mujoco_table() -> str:
    """Return a Markdown table with the largest distance from MuJoCo by control period and substeps."""
    rows = []
    for period in PERIODS:
        runs = [position_errors(UNEQUAL, seed, MUJOCO_SECONDS, period, SUBSTEPS) for seed in MUJOCO_SEEDS]
        worst = [1000.0 * max(run[number] for run in runs) for number in SUBSTEPS]
        rows.append([f"{1000.0 * period:g} ms", *(f"{value:.1e}" for value in worst)])
    return markdown_table(["control period", *(f"{number} substeps" for number in SUBSTEPS)], rows)


def _coverage(estimate: Callable[[Any], Any], draw: Callable[[], Any], truth: float, trials: int) -> str:
    intervals = [estimate(draw()) for _ in range(trials)]
    return f"{100.0 * np.mean([low <= truth <= high for _, low, high in intervals]):.1f}"


def coverage_table(trials: int = TRIALS, slow_trials: int = SLOW_TRIALS) -> str:
    """Return a Markdown table with the coverage in % of every 95 % interval by the number of episodes."""
    random, rows = np.random.default_rng(1), []

    def add(name: str, estimate: Any, draw: Callable[[int], Any], truth: float, number: int = trials) -> None:
        rows.append([name, *(_coverage(estimate, lambda n=n: draw(n), truth, number) for n in SIZES)])  # type: ignore[misc]

    known = populations()
    for name, population in known.items():
        add(f"mean, {name}", statistics.mean, lambda n, p=population: p.draw(random, (1, n)), population.mean)  # type: ignore[misc]
    for name, population in known.items():
        add(
            f"interquartile mean, {name}",
            statistics.interquartile_mean,
            lambda n, p=population: p.draw(random, (1, n)),  # type: ignore[misc]
            population.middle,
            slow_trials,
        )
    for share in (0.9, 0.99):
        name = f"survival of {100 * share:g} %"
        add(name, statistics.proportion, lambda n, p=share: random.random((1, n)) < p, share)  # type: ignore[misc]
    add(
        "difference of survivals, 95 % and 90 %",
        lambda pair: statistics.paired_proportion(*pair),
        lambda n: (random.random((1, n)) < 0.95, random.random((1, n)) < 0.9),
        0.05,
    )

    def improvement(values: Any) -> Any:
        return statistics.probability_of_improvement(values, np.zeros_like(values))

    for share in (0.5, 0.9, 0.99):
        name = f"probability of improvement of {100 * share:g} %"
        add(name, improvement, lambda n, p=share: p_signs(random, p, n), share)  # type: ignore[misc]
    for seeds in (2, 5):
        add(
            f"mean over {seeds} training seeds, normal",
            statistics.mean,
            lambda n, s=seeds: random.normal(size=(s, 1)) + random.normal(size=(1, n)) + random.normal(size=(s, n)),  # type: ignore[misc]
            0.0,
        )
    add(
        "interquartile mean over 5 training seeds, normal",
        statistics.interquartile_mean,
        lambda n: random.normal(size=(5, 1)) + random.normal(size=(1, n)) + random.normal(size=(5, n)),
        0.0,
        slow_trials // 2,
    )
    return markdown_table(["interval", *(f"{n} episodes" for n in SIZES)], rows)


def p_signs(random: np.random.Generator, share: float, number: int) -> Any:
    """Return −1 with probability `share`, otherwise 1, shape (1, number)."""
    return np.where(random.random((1, number)) < share, -1.0, 1.0)


def error_table(trials: int = TRIALS, families: int = FAMILY_TRIALS) -> str:
    """Return a Markdown table with the share in % of true hypotheses that the tests reject at the 5 % level."""
    random = np.random.default_rng(2)

    def rate(p: Callable[[int], float], number: int) -> list[str]:
        return [f"{100.0 * np.mean([p(n) < 0.05 for _ in range(number)]):.1f}" for n in SIZES]

    rows: list[list[str]] = []

    def equal(draw: Draw, n: int) -> float:
        return statistics.p_value(draw(random, (1, n)) - draw(random, (1, n)))

    rows += [[f"RMSE, both {name}", *rate(partial(equal, draw), trials)] for name, (draw, _) in DRAWS.items()]
    rows.append(
        [
            "survival, both 95 %",
            *rate(
                lambda n: statistics.p_proportion(random.random((1, n)) < 0.95, random.random((1, n)) < 0.95), trials
            ),
        ]
    )

    def learner(n: int) -> float:
        effects = random.normal(size=(5, 1)) + random.normal(size=(1, n))
        return statistics.p_value(effects + random.normal(size=(5, n)))

    rows.append(["RMSE, five training seeds", *rate(learner, trials)])
    for name in ("exponential", "lognormal"):
        draw, truth = DRAWS[name]
        rows.append(
            [
                f"RMSE, {name} differences with mean zero",
                *rate(partial(lambda d, m, n: statistics.p_value(d(random, (1, n)) - m), draw, truth), trials),
            ]
        )

    def skewed_learner(n: int) -> float:
        effects = random.exponential(size=(5, 1)) - 1.0 + random.normal(size=(1, n))
        return statistics.p_value(effects + random.normal(size=(5, n)))

    rows.append(["RMSE, five training seeds with exponential effects", *rate(skewed_learner, trials)])
    rows.append([f"any of {FAMILY} scenarios, corrected", *rate(lambda n: _family(random, n), families)])
    return markdown_table(["hypothesis", *(f"{n} episodes" for n in SIZES)], rows)


def _family(random: np.random.Generator, episodes: int) -> float:
    """Return the smallest corrected p-value of two equal policies in all scenarios, by survival and by RMSE."""
    p_values = []
    for _ in range(FAMILY):
        survived = random.random((2, 1, episodes)) < 0.95
        differences = random.gamma(4.0, 0.005, (1, episodes)) - random.gamma(4.0, 0.005, (1, episodes))
        both = survived[0] & survived[1]
        p_values += [statistics.p_proportion(*survived), statistics.p_value(np.where(both, differences, np.nan))]
    return min(statistics.holm(p_values))


def run(document: Path, steps: int = 1_000_000) -> None:
    """Measure and update the page.

    Args:
        document: Page with the parts energy, mujoco, coverage and errors.
        steps: Control periods of the energy's drift.
    """
    energy, episode, largest = energy_drift(steps)
    drift = [
        [r"mean of \|E\|", f"{energy:.2g} J"],
        ["largest drift in an episode of 1000 steps", f"{episode:.1e} J"],
        [f"largest drift in {steps:,} steps", f"{largest:.1e} J"],
        ["drift for each step", f"{largest / steps:.1e} J"],
    ]
    parts = {
        "energy": markdown_table(["quantity", "value"], drift),
        "mujoco": mujoco_table(),
        "coverage": coverage_table(),
        "errors": error_table(),
    }
    fill(document, parts)
    print("\n\n".join(parts.values()))


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description="Measure accuracy and coverage.")
    parser.add_argument("--document", type=Path, default=Path("docs/accuracy.md"), help="page to update")
    run(parser.parse_args().document)


if __name__ == "__main__":
    main()
