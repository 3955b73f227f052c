"""docs/bound/: the best flight of each episode with everything known in advance, and the gap of policies to it.

    python -m experiments.bound --jobs 2 --episodes 8      # seeds from 1000000; forty minutes; needs the extra mpc

The planner finds a local optimum. A flight counts as the environment flies it, with float32 actions, so a number in the
tables is never better than what is possible, and the best flight may be better. The planner starts from the flight of
`flatness`; where it finds no better one, that flight counts, since a clairvoyant could repeat it. Episodes that are in
docs/bound/bound.csv are not planned again: delete their lines first.
"""

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gymnasium.vector import AutoresetMode

from experiments.pages import CACHE, DOCS, fill, interval_figure, made_by, options
from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.planning.episode import Flight, KnownEpisode, known_episode, record_flight
from quadpend_baselines.planning.replay import track
from quadpend_baselines.planning.transcription import Plant, Transcription, transcription
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs.world import world_of
from quadpend_gym.scenarios import SETS, Scenario, find_scenario
from quadpend_train.common.executors import run
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import FALL_ERROR, collect_results
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.leaderboard import LeaderboardRow, standing
from quadpend_train.evaluation.statistics import Interval, mean
from quadpend_train.evaluation.table import cells
from quadpend_train.reports import figures

FOLDER = DOCS / "bound"
CLAIRVOYANT = "clairvoyant"  # its name in tables
FIRST_GUESS = "flatness"  # controller whose flight the planner starts from, and against which gaps are measured
POLICIES = (FIRST_GUESS, "dual-mode", "apg", "ppo-gain-scheduling")
_CONVERGED = "Solve_Succeeded"  # status of the solver
_MM = 1000.0


def can_be_planned(scenario: Scenario) -> bool:
    """Return whether IPOPT plans the scenario: the paper's vehicle, upright, with delays and lags of the action.

    Saturating rotors keep IPOPT from converging for rigid vehicles; `planning.ilqr` improves their flights.
    """
    task = scenario.task
    upright = task.pendulum == "upright" and task.reward.pendulum_first == 0.0
    known = all(isinstance(model, ActionDelay | MotorLag) for model in scenario.actuators)
    return upright and known and scenario.vehicle.attitude == "euler"


def plant_of(scenario: Scenario) -> Plant:
    """Return the plant of a scenario. Sensors do not matter to a planner that knows the state."""
    loop = Loop.of(actuators=scenario.actuators)
    moves_air = any(model.moves_air for model in scenario.wind_models)
    return Plant(scenario.simulation, moves_air, tuple(model.time_constant for model in loop.actuators), loop.delay)


def plan_episode(name: str, scenario: Scenario, seed: int) -> dict[str, Any]:
    """Return the best flight of an episode: the planned one, or that of the first guess if it is better; errors in mm.

    If the solver does not converge from the first guess, it starts again from an upright pole at the reference, and
    then from the best flight of the same episode without wind.
    """
    begin, steps = time.process_time(), scenario.steps
    longer = scenario.make_vec(1, AutoresetMode.SAME_STEP, max_episode_steps=steps + 1)
    env = scenario.make_vec(1, AutoresetMode.SAME_STEP)
    world = world_of(env)
    policy = controller(FIRST_GUESS).adapt(scenario)
    episode, guess = known_episode(longer, seed, steps), record_flight(policy, longer, seed, steps)
    problem = transcription(plant_of(scenario), world.task.limits, steps)
    upright = Flight(guess.states[:1], guess.actions[:0])
    starts = [
        partial(problem.guess, guess, episode),
        partial(problem.guess, upright, episode),
        partial(_without_wind, problem, episode, guess),
    ]
    tried = []
    for start in starts:
        solution = problem.solve(episode, *start())
        errors = _errors(track(solution, problem, episode, world), env, seed, scenario)
        tried.append((errors, solution))
        if errors[0] < np.inf and solution.status == _CONVERGED:
            break
    optimum, best = min(tried, key=lambda item: item[0])
    found = {"optimum": optimum, FIRST_GUESS: _errors(policy, env, seed, scenario)}
    source = min(found, key=lambda name: found[name][0])
    survived = found[source][0] < np.inf
    rmse, settled = found[source] if survived else (np.nan, np.nan)
    return {
        "scenario": name,
        "seed": seed,
        "survived": int(survived),
        "rmse": _MM * rmse,
        "settled_rmse": _MM * settled,
        "planned_rmse": _MM * best.rmse,
        "source": source if survived else "",
        "status": best.status,
        "iterations": sum(solution.iterations for _, solution in tried),
        "seconds": round(time.process_time() - begin, 2),
    }


def _without_wind(problem: Transcription, episode: KnownEpisode, guess: Flight) -> tuple[Floats, Floats]:
    """Return states and actions of the planned flight of an episode without its wind, a first guess with wind."""
    calm = episode._replace(wind=np.zeros_like(episode.wind))
    solution = problem.solve(calm, *problem.guess(guess, calm))
    return solution.states, solution.actions


def _errors(policy: Any, env: Any, seed: int, scenario: Scenario) -> tuple[float, float]:
    """Return the RMSE of a flight over all steps and over the second half, m; infinite after a fall."""
    results = collect_results(rollout(policy, env, seed), np.array([scenario.steps]), scenario.simulation.period)
    return (float(results.rmse[0]), float(results.settled_rmse[0])) if results.survived[0] else (np.inf, np.inf)


def plan(scenarios: Mapping[str, Scenario], episodes: int, seed: int, path: Path, jobs: int) -> None:
    """Plan the episodes that are not in a `bound.csv`, which is written after each of them."""
    stored = pd.read_csv(path).to_dict("records") if path.exists() else []
    present = {(row["scenario"], row["seed"]) for row in stored}
    wanted = [(name, seed + k) for k in range(episodes) for name in scenarios]
    calls = {key: partial(plan_episode, key[0], scenarios[key[0]], key[1]) for key in wanted if key not in present}

    def save(_: Any, row: dict[str, Any]) -> None:
        stored.append(row)
        table = pd.DataFrame(stored).sort_values(["scenario", "seed"])
        write_text(path, table.to_csv(index=False, lineterminator="\n"))

    run(calls, jobs, done=save, what="episode", finished=len(wanted) - len(calls))


def read(path: Path, scenarios: Sequence[str], episodes: int, seed: int) -> dict[str, pd.DataFrame]:
    """Return the stored episodes of each scenario, with the column `penalised_rmse`, mm; a fall counts as 1 m."""
    table = pd.read_csv(path)
    fall = _MM * FALL_ERROR
    table["survived"] = table["survived"] == 1
    table["penalised_rmse"] = table["rmse"].clip(upper=fall).where(table["survived"], fall)
    table = table[(table["seed"] >= seed) & (table["seed"] < seed + episodes)]
    return {name: table[table["scenario"] == name].sort_values("seed") for name in scenarios}


def bound_row(found: Mapping[str, pd.DataFrame], comparison: Comparison, reference: str) -> LeaderboardRow:
    """Return the row of the leaderboard for planned episodes; wins and losses are not counted.

    The planned episodes are the first ones of a comparison with more episodes. Their starts may be nearer to the
    target, or farther, so their mean would not be comparable with the other rows. A reference policy corrects for that
    (control variate): c_k is the median over the scenarios of its error in episode k, which depends on the start and
    hardly on falls, and the row is the mean of the planned flights, plus the mean of c over all episodes, minus its
    mean over the planned ones. Survival is that of the flights that were found: a lower bound.
    """
    episodes = len(next(iter(found.values())))
    values = cells(comparison.table)
    control = np.median([_MM * values[name, reference]["penalised_rmse"].mean(axis=0) for name in found], axis=0)
    planned = np.mean([_column(flights, "penalised_rmse") for flights in found.values()], axis=0)
    columns = ("survived", "penalised_rmse")
    shown = {name: {key: _column(flights, key) for key in columns} for name, flights in found.items()}
    difference = mean(planned - control[:episodes])
    row = standing(f"{CLAIRVOYANT} (no policy; from {episodes} episodes)", shown)
    return row._replace(penalised_rmse=Interval(*(float(control.mean()) + x for x in difference)))


def _column(flights: pd.DataFrame, name: str) -> Any:
    return flights[name].to_numpy()[np.newaxis]


def _closed(first: Floats, gap: Floats) -> Interval:
    """Return 100 (1 − mean gap / mean first gap) in %, with the interval of the ratio linearised in its two means."""
    with np.errstate(divide="ignore", invalid="ignore"):
        closed = 1.0 - gap.mean() / first.mean()
        return mean(closed + ((1.0 - closed) * first - gap) / first.mean()).scaled(100.0)


def gap_table(found: Mapping[str, pd.DataFrame], comparison: Comparison) -> tuple[str, dict[str, dict[str, Interval]]]:
    """Return a Markdown table with a line for each scenario, and the gap of each policy in mm."""
    headings = ["scenario", "survivable (%)", f"{CLAIRVOYANT} (mm)", "settled (mm)"]
    for policy in comparison.policies:
        headings += [f"{policy} (mm)", "settled (mm)", "gap (mm)", *(["closed (%)"] if policy != FIRST_GUESS else [])]
    rows, gaps, values = [], {}, cells(comparison.table)
    for name, flights in found.items():
        best = _column(flights, "penalised_rmse")
        errors = (format_interval(mean(item).clipped(0.0)) for item in (best, _column(flights, "settled_rmse")))
        line = [name, f"≥ {100.0 * flights['survived'].mean():.3g}", *errors]
        gap = {p: _MM * values[name, p]["penalised_rmse"] - best for p in comparison.policies}
        for policy, difference in gap.items():
            summary = comparison.summaries[name, policy]
            line += [format_number(summary[error].value) for error in ("penalised_rmse", "settled_rmse")]
            line.append(format_interval(mean(difference)))
            if policy != FIRST_GUESS:
                closed = _closed(gap[FIRST_GUESS], difference)
                line.append("–" if closed.value < 0.0 else format_interval(closed))
        rows.append(line)
        gaps[name] = {policy: mean(difference) for policy, difference in gap.items()}
    return markdown_table(headings, rows), gaps


def main() -> None:
    """Plan, compare, and write the page with its figure and its data."""
    given = options(__doc__, 8)
    scenarios = {name: find_scenario(name) for name in dict.fromkeys([*SETS["test"], "windy"])}
    scenarios = {name: scenario for name, scenario in scenarios.items() if can_be_planned(scenario)}
    plan(scenarios, given.episodes, given.seed, FOLDER / "bound.csv", given.jobs)
    found = read(FOLDER / "bound.csv", list(scenarios), given.episodes, given.seed)
    comparison = compare(POLICIES, scenarios, given.episodes, given.seed, CACHE, jobs=given.jobs)
    table, gaps = gap_table(found, comparison)
    label = "penalised RMSE minus that of the best flight that was found (mm)"
    figures.write_png(interval_figure(gaps, label, log=True), FOLDER / "bound.png")
    fill(DOCS / "bound/tables.md", {"bound": f"{made_by('bound', given.episodes, given.seed)}\n\n{table}"})


if __name__ == "__main__":
    main()
