"""Robustness part of docs/results.md: survival and error under growing perturbations.

    python -m experiments.robustness --jobs 2                         # the policies of docs/results.md, an hour
    python -m experiments.robustness flatness mine=mine:make --out results/robustness

50 episodes at each value, seeds from 1000000. At every value of an axis all policies run through the same episodes:
starts, references, headings and noise are common, only the size of the perturbation differs. The tolerance limit is the
value at which survival first falls below 90 %, interpolated linearly; the ends of its interval come in the same way
from the ends of the interval of the survival.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments.pages import CACHE, DOCS, fill, options
from experiments.perturbations import PERTURBATION_AXES, PerturbationAxis
from experiments.results import CLASSICAL, LEARNED
from quadpend_train.evaluation.comparison import named_policies
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.evaluation.table import summarise, values_of
from quadpend_train.policies.loading import load_policies
from quadpend_train.reports import figures

TOLERATED_SURVIVAL = 90.0  # %
Curve = list[dict[str, Interval]]  # metrics at each value of an axis


class Robustness(NamedTuple):
    """Metrics by the names of axis and policy."""

    axes: Mapping[str, PerturbationAxis]
    curves: dict[tuple[str, str], Curve]

    @property
    def policies(self) -> list[str]:
        """Names of the policies."""
        return list(dict.fromkeys(policy for _, policy in self.curves))


def measure(
    policies: Mapping[str, Any],
    episodes: int,
    seed: int = TEST_SEED,
    axes: Mapping[str, PerturbationAxis] = PERTURBATION_AXES,
    **settings: Any,
) -> Robustness:
    """Evaluate every policy at all values of every axis; `settings` of `run_jobs`."""
    jobs: dict[Any, Job] = {}
    for policy, learner in ((name, load_policies(policy)) for name, policy in policies.items()):
        for name, axis in axes.items():
            for value in axis.values:
                options = axis.options(value, episodes, seed)
                jobs[name, policy, value] = Job(learner, axis.scenario(value), episodes, seed, options)
    results = run_jobs(jobs, **settings)
    curves = {
        (name, policy): [summarise(values_of(results[name, policy, value])) for value in axis.values]
        for policy in policies
        for name, axis in axes.items()
    }
    return Robustness(axes, curves)


def tolerance_limit(values: Sequence[float], survival: Sequence[float]) -> float:
    """Return the value at which survivals, %, at values from the nominal one outwards fall below `TOLERATED_SURVIVAL`.

    It is nan if the nominal value is below, and infinite if none is.
    """
    below = [share < TOLERATED_SURVIVAL for share in survival]
    if not any(below):
        return np.inf
    i = below.index(True)
    if not i:
        return np.nan
    fraction = (survival[i - 1] - TOLERATED_SURVIVAL) / (survival[i - 1] - survival[i])
    return values[i - 1] + fraction * (values[i] - values[i - 1])


def tolerated_range(axis: PerturbationAxis, curve: Curve) -> str:
    """Return the tolerance limits of an axis and their intervals as text, in the unit of the axis.

    Examples: ``0.4 [0.3, 0.5]``; ``> 0.6`` if all values are tolerated; ``–`` if the nominal value is not. If the
    nominal value is not the first one, the lower limit stands first: ``0.8 [0.7, 0.9] to > 2``.
    """
    nominal, texts = axis.values.index(axis.nominal), []
    for sign, outwards in (("<", slice(nominal, None, -1)), (">", slice(nominal, None))):
        if sign == "<" and not nominal:
            continue
        values, shares = axis.values[outwards], np.array([point["survival"] for point in curve])[outwards].T
        limits = [tolerance_limit(values, share.tolist()) for share in shares]
        shown = {np.inf: f"{sign} {values[-1]:g}"}
        estimate, low, high = (shown.get(x, "–" if np.isnan(x) else f"{x:.2g}") for x in limits)
        low, high = (low, high) if sign == ">" else (high, low)
        texts.append(estimate if limits[1] == np.inf else f"{estimate} [{low}, {high}]")
    return " to ".join(texts)


def markdown(found: Robustness) -> str:
    """Return the table of the tolerated range on each axis."""
    rows = [
        [axis.label, *(tolerated_range(axis, found.curves[name, policy]) for policy in found.policies)]
        for name, axis in found.axes.items()
    ]
    return markdown_table(["", *found.policies], rows)


def draw_axis(survival: Any, rmse: Any, axis: PerturbationAxis, curves: Mapping[str, Curve]) -> None:
    """Draw survival and penalised RMSE of policies along one axis."""
    for i, curve in enumerate(curves.values()):
        for part, name in ((survival, "survival"), (rmse, "penalised_rmse")):
            middle, low, high = np.array([point[name] for point in curve]).T
            figures.draw_curve(part, i, axis.values, low, middle, high)
        rmse.plot(axis.values, middle, ".", color=figures.colour(i), markersize=4)
    survival.axhline(TOLERATED_SURVIVAL, color="#888888", linewidth=0.8, linestyle=":")
    survival.set(ylabel="survival (%)", ylim=(-3.0, 103.0))
    rmse.set(ylabel="penalised RMSE (mm)", xlabel=axis.label)
    for part in (survival, rmse):
        if axis.scale == "symlog":
            part.set_xscale("symlog", linthresh=axis.values[1], linscale=0.4)
            part.set_xticks(axis.values, [f"{value:g}" for value in axis.values], fontsize=8)
            part.minorticks_off()
        part.set_xlim(axis.values[0], axis.values[-1])
        part.grid(alpha=0.25)


def draw_curves(found: Robustness) -> Any:
    """Return a figure of all axes, three beside each other, which share the scale of the RMSE."""
    rows = -(-len(found.axes) // 3)
    figure = figures.new_figure(10.8, 3.4 * rows + 0.4)
    axes = figures.add_axes(figure, 2 * rows, 3)
    values = np.array([point["penalised_rmse"] for curve in found.curves.values() for point in curve])
    for i, (name, axis) in enumerate(found.axes.items()):
        survival, rmse = axes[2 * (i // 3), i % 3], axes[2 * (i // 3) + 1, i % 3]
        draw_axis(survival, rmse, axis, {policy: found.curves[name, policy] for policy in found.policies})
        figures.set_log_scale(rmse, float(values[values > 0.0].min()), float(values.max()))
    for part in axes.ravel():
        part.set_axis_on() if part.has_data() else part.set_axis_off()
    figures.add_legend(figure, tuple(found.policies))
    return figure


def main() -> None:
    """Measure, draw, and fill the page if its policies were measured."""
    given = options(__doc__, 50, out=DOCS / "results")
    # Of a learner with several training seeds, the first is measured.
    published = {**{name: f"{name}-0" for name in LEARNED}, **{name: name for name in CLASSICAL}}
    named = named_policies(given.policies)
    found = measure(named or published, given.episodes, given.seed, cache_folder=CACHE, processes=given.jobs)
    given.out.mkdir(parents=True, exist_ok=True)
    figures.write_png(draw_curves(found), given.out / "curves.png")
    if not named:
        fill(DOCS / "results.md", {"robustness": markdown(found)})
    print(markdown(found))


if __name__ == "__main__":
    main()
