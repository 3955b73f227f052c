"""How good a flight could be: the optimum of each episode with start, reference, wind and parameters known in advance.

`quadpend_baselines.planning` plans the flight, a local optimum. A flight counts as the environment flies it, with
float32 actions, so a number in the tables is never better than what is possible, and the best flight may be better. The
planner starts from the flight of a classical controller; where it finds no better flight, the controller's flight
counts, since a clairvoyant could repeat it.
"""

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

import quadpend_baselines
from quadpend_baselines import controller
from quadpend_baselines.controllers import nmpc_model
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.planning.episode import Flight, KnownEpisode, known_episode, record_flight, tracked_point
from quadpend_baselines.planning.plant import Plant
from quadpend_baselines.planning.replay import track
from quadpend_baselines.planning.transcription import Solution, Transcription, transcription
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.source_hash import source_hash
from quadpend_gym.scenarios import Scenario, scenario_hash
from quadpend_train.common.executors import run
from quadpend_train.common.files import to_json_data
from quadpend_train.evaluation.bound import (
    CLAIRVOYANT,
    BoundEpisode,
    by_scenario,
    penalised_rmse,
    read_bound,
    settled_rmse,
    write_bound,
)
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import collect_results
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.statistics import Interval, mean, proportion

FIRST_GUESS = "flatness"  # controller whose flight the planner starts from, and against which gaps are measured
_SOURCES = [Path(str(quadpend_baselines.__file__)).parent / "planning", Path(str(nmpc_model.__file__))]
_CONVERGED = "Solve_Succeeded"  # status of the solver
_MILLIMETRES = 1000.0


class Task(NamedTuple):
    """One episode to plan.

    Attributes:
        name: Name of the scenario.
        scenario: The scenario.
        seed: Seed of the episode.
    """

    name: str
    scenario: Scenario
    seed: int

    @property
    def key(self) -> str:
        """Hash of the scenario, the seed and the code of the planner, twelve hexadecimal digits."""
        parts = [scenario_hash(self.scenario), self.seed, source_hash(_SOURCES)]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


def left_out(scenario: Scenario) -> str:
    """Return why the episodes of a scenario cannot be planned; empty if they can."""
    if scenario.simulation.is_rigid:
        return "the planner has the paper's attitude model, and the vehicle is a rigid body"
    if scenario.resolved_task.pendulum != "upright" or scenario.resolved_task.reward.pendulum_first > 0.0:
        return "the planner balances an upright pendulum, and the task is another one"
    others = [model for model in scenario.actuators if not isinstance(model, ActionDelay | MotorLag)]
    if others:
        return f"the planner has delays and lags of the action, but no {others[0].kind}"
    return ""


def plant_of(scenario: Scenario) -> Plant:
    """Return the plant of a scenario that is not left out. Sensors do not matter to a planner that knows the state."""
    loop = Loop.of(actuators=scenario.actuators)
    return Plant(
        scenario.simulation,
        any(model.moves_air for model in scenario.wind.models),
        tuple(model.time_constant for model in loop.actuators),
        loop.delay,
    )


def plan_episode(task: Task) -> BoundEpisode:
    """Return the best flight of an episode: the planned one, or that of the first guess if it is better.

    If the solver does not converge from the first guess, it starts again from an upright pole at the reference, and
    then from the best flight of the same episode without wind.
    """
    name, scenario, seed = task
    begin, steps = time.process_time(), scenario.steps
    longer = scenario.make_vec(1, AutoresetMode.SAME_STEP, max_episode_steps=steps + 1)
    env = scenario.make_vec(1, AutoresetMode.SAME_STEP)
    world: Any = env.unwrapped.world  # type: ignore[attr-defined]
    policy = controller(FIRST_GUESS).adapt(scenario)
    episode, guess = known_episode(longer, seed, steps), record_flight(policy, longer, seed, steps)
    problem = transcription(plant_of(scenario), world.task.limits, steps)

    starts: list[Callable[[], tuple[Floats, Floats]]] = [
        lambda: problem.guess(guess, episode),
        lambda: problem.guess(Flight(guess.states[:1], guess.actions[:0]), episode),
        lambda: _without_wind(problem, episode, guess),
    ]
    tried: list[tuple[float, float, Solution]] = []
    for start in starts:
        solution = problem.solve(episode, *start())
        flown = rollout(track(solution, problem, episode, world), env, seed)
        results = collect_results(flown, np.array([steps]), scenario.simulation.period)
        survived = bool(results.survived[0])
        tried.append((float(results.rmse[0]) if survived else np.inf, float(results.settled_rmse[0]), solution))
        if survived and solution.status == _CONVERGED:
            break
    *errors, best = min(tried, key=lambda item: item[0])
    found = {"optimum": tuple(errors)} if errors[0] < np.inf else {}
    if len(guess.actions) == steps:
        found[FIRST_GUESS] = _errors(guess, episode)
    source = min(found, key=lambda name: found[name][0], default="")
    rmse, settled_rmse = found.get(source, (np.nan, np.nan))
    return BoundEpisode(
        name,
        seed,
        bool(found),
        _MILLIMETRES * rmse,
        _MILLIMETRES * settled_rmse,
        _MILLIMETRES * best.rmse,
        source,
        best.status,
        sum(solution.iterations for *_, solution in tried),
        round(time.process_time() - begin, 2),
        task.key,
    )


def _without_wind(problem: Transcription, episode: KnownEpisode, guess: Flight) -> tuple[Floats, Floats]:
    """Return states and actions of the planned flight of an episode without its wind, a first guess with wind."""
    calm = episode._replace(wind=np.zeros_like(episode.wind))
    solution = problem.solve(calm, *problem.guess(guess, calm))
    return solution.states, solution.actions


def _errors(flight: Flight, episode: KnownEpisode) -> tuple[float, float]:
    """Return the RMSE of a flight that survives, over all steps and over the second half, m."""
    error = tracked_point(flight.states[1:], episode.parameters) - episode.target
    squared = np.sum(error**2, axis=1)
    return float(np.sqrt(squared.mean())), float(np.sqrt(squared[len(squared) // 2 :].mean()))


def plan(
    scenarios: Mapping[str, Scenario],
    episodes: int,
    seed: int,
    folder: Path,
    jobs: int | Executor = 1,
    recompute: bool = False,
) -> dict[str, list[BoundEpisode]]:
    """Plan the missing episodes of `bound.csv` in a folder, which is written after each of them.

    Args:
        scenarios: Scenarios by name, none of which is left out.
        episodes: Number of episodes of each scenario.
        seed: Seed of the first episode.
        folder: Folder of `bound.csv`. Its other episodes are kept.
        jobs: Number of processes, or an executor; the results do not depend on it.
        recompute: Whether to plan stored episodes again.

    Returns:
        The episodes of each scenario.

    Raises:
        CallsFailedError: If episodes fail; the others are in `bound.csv`.
    """
    path = folder / "bound.csv"
    stored = {(item.scenario, item.seed): item for item in read_bound(path)} if path.exists() else {}
    tasks = [Task(name, scenario, seed + k) for k in range(episodes) for name, scenario in scenarios.items()]
    missing = [task for task in tasks if recompute or not _is_current(task, stored)]
    calls = {(task.name, task.seed): partial(plan_episode, task) for task in missing}

    def save(place: tuple[str, int], episode: BoundEpisode) -> None:
        stored[place] = episode
        write_bound(path, [stored[place] for place in sorted(stored, key=lambda place: (place[0], place[1]))])

    run(calls, jobs, done=save, what="episode", kept=f"are in {path}", finished=len(tasks) - len(missing))
    return by_scenario(list(stored.values()), list(scenarios), seed, episodes)


def _is_current(task: Task, stored: Mapping[tuple[str, int], BoundEpisode]) -> bool:
    found = stored.get((task.name, task.seed))
    return found is not None and found.key == task.key


class Gap(NamedTuple):
    """How far a policy is from the optimum in one scenario, in the episodes that were planned.

    Attributes:
        rmse: Penalised RMSE, mm.
        settled_rmse: RMSE over the second half of the survived episodes, mm.
        gap: Difference of the penalised RMSE from that of the clairvoyant, episode by episode, mm.
        closed: Share of the gap of `FIRST_GUESS` that the policy closes, %; nan for that policy.
    """

    rmse: Interval
    settled_rmse: Interval
    gap: Interval
    closed: Interval


def gaps(found: Mapping[str, Sequence[BoundEpisode]], comparison: Comparison) -> dict[str, dict[str, Gap]]:
    """Return the gaps of all policies of a comparison over the same episodes, by scenario and policy."""
    out = {}
    for scenario, episodes in found.items():
        best = penalised_rmse(episodes)
        values = {p: _MILLIMETRES * comparison.results[scenario, p].penalised_rmse for p in comparison.policies}
        first = values.get(FIRST_GUESS, np.full_like(best, np.nan))
        out[scenario] = {
            policy: Gap(
                mean(value).not_negative(),
                mean(_MILLIMETRES * comparison.results[scenario, policy].settled_rmse).not_negative(),
                mean(value - best),
                _closed(first - best, value - best) if policy != FIRST_GUESS else Interval(*[np.nan] * 3),
            )
            for policy, value in values.items()
        }
    return out


def _closed(first: Floats, gap: Floats) -> Interval:
    """Return 100 (1 − mean gap / mean first gap) in %, with the interval of the ratio linearised in its two means.

    Args:
        first: Gap of `FIRST_GUESS` in each episode, shape (1, n).
        gap: Gap of the policy, shape (s, n).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        closed = 1.0 - gap.mean() / first.mean()
        return mean(closed + ((1.0 - closed) * first - gap) / first.mean()).scaled(100.0)


def markdown(found: Mapping[str, Sequence[BoundEpisode]], measured: Mapping[str, Mapping[str, Gap]]) -> str:
    """Return a Markdown table with a line for each scenario."""
    policies = list(next(iter(measured.values())))
    headings = ["scenario", "survivable (%)", f"{CLAIRVOYANT} (mm)", "settled (mm)"]
    for policy in policies:
        headings += [f"{policy} (mm)", "settled (mm)", "gap (mm)", *(["closed (%)"] if policy != FIRST_GUESS else [])]
    rows = []
    for scenario, episodes in found.items():
        survived = 100.0 * np.mean([item.survived for item in episodes])
        best = (
            format_interval(mean(values).not_negative())
            for values in (penalised_rmse(episodes), settled_rmse(episodes))
        )
        cells = [scenario, f"≥ {survived:.3g}", *best]
        for policy in policies:
            gap = measured[scenario][policy]
            cells += [format_number(gap.rmse.value), format_number(gap.settled_rmse.value), format_interval(gap.gap)]
            if policy != FIRST_GUESS:
                cells.append("–" if gap.closed.value < 0.0 else format_interval(gap.closed))
        rows.append(cells)
    return markdown_table(headings, rows)


def as_data(found: Mapping[str, Sequence[BoundEpisode]], measured: Mapping[str, Mapping[str, Gap]]) -> dict[str, Any]:
    """Return the numbers of the table as data for JSON, in mm and as shares."""
    return {
        scenario: {
            CLAIRVOYANT: to_json_data(
                {
                    "survival": proportion(np.array([[item.survived for item in episodes]])),
                    "penalised_rmse": mean(penalised_rmse(episodes)).not_negative(),
                    "settled_rmse": mean(settled_rmse(episodes)).not_negative(),
                }
            ),
            **{policy: to_json_data(gap) for policy, gap in measured[scenario].items()},
        }
        for scenario, episodes in found.items()
    }
