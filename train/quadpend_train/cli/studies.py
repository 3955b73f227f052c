"""The commands of the studies: `tune`, `ablate`, `situation`, `wind` and `paper`.

The parameters of these functions are the options of the commands. Slow imports are inside the functions, so that
`quadpend --help` starts quickly.
"""

import json
import shlex
from pathlib import Path

import tyro

from quadpend_gym.core.factories import is_factory
from quadpend_gym.scenarios import with_changes
from quadpend_train.cli.options import Episodes, Seed, Trials, make_console, named_model, named_scenarios
from quadpend_train.common.executors import executor
from quadpend_train.common.files import writable_file, writable_folder, write_text
from quadpend_train.evaluation.cache import FOLDER, check_folder
from quadpend_train.evaluation.episodes import VALIDATION_SEED


def tune(
    controllers: tyro.conf.Positional[tuple[str, ...]],
    trials: Trials = 150,
    episodes: Episodes = 48,
    seed: Seed = 0,
    out: Path = Path("results/tune"),
    scenarios: tuple[str, ...] = ("training",),
    vehicle: str | None = None,
    interface: str | None = None,
    storage: str | None = None,
) -> None:
    """Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.

    An interrupted search continues after its last trial, with the same result. The command does not change the package:
    copy the gains into baselines/quadpend_baselines/gains.py. The same command in several terminals or on several
    machines searches with all of them, if it has a --storage that all can open.

    Args:
        controllers: Controllers with tunable gains, see train/quadpend_train/studies/search/tuning.py.
        trials: Trials of the search for each controller.
        episodes: Episodes in each scenario.
        seed: Seed of the search.
        out: Folder for the losses of all trials and for the gains that it finds, NAME.json.
        scenarios: Scenarios with the same vehicle and control period, for which the controllers are designed: names,
            TOML or JSON files, or JSON. "training" stands for all training scenarios.
        vehicle: Vehicle of all scenarios: the name of a preset (quadpend list vehicles) or a TOML file. Forces of the
            wind are multiplied by the ratio of its weight to that of the scenario's vehicle, torques by the ratio of
            the torque limits; wind velocities stay.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
        storage: File, or URL of a database such as sqlite:///search.db or postgresql://…, for the trials of all
            processes; then OUT also gets a picture of the search, NAME.png. Opening a storage executes code that it
            contains: use only storages that you trust.
    """
    from quadpend_train.reports import figures, search_plots
    from quadpend_train.studies.search import tuning

    tuning.check_names(controllers)
    writable_folder(out)
    chosen = [with_changes(name, vehicle, interface) for name in scenarios]
    for name in controllers:
        print(json.dumps(tuning.tune(name, trials, episodes, seed, out, chosen, storage), indent=1))
        if storage is not None:
            study = tuning.open_search(name, episodes, seed, chosen, storage)
            figures.write_png(search_plots.draw(study, "loss (mm)"), out / f"{name}.png")


def sweep(
    settings: tyro.conf.Positional[str],
    trials: Trials = 32,
    seconds: float = 60.0,
    out: Path = Path("results/sweep"),
    space: Path | None = None,
    storage: str | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    eval_freq: int = 0,
    seed: Seed = 0,
) -> None:
    """Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.

    The same command continues an interrupted search. In several terminals or on several machines it searches with all
    of them, if it has a --storage that all can open, and an --out for each machine. `quadpend train --settings
    OUT/best.toml` trains with the settings that it finds.

    Args:
        settings: Settings from which the search starts, as --settings of train; the first trial has them.
        trials: Trials of the search, those included that are stopped early since the median of the others is better.
        seconds: Duration of the training of a trial, s.
        out: Folder for best.toml (the settings), trials.csv, sweep.png and the trainings.
        space: Search space, a settings file with a range {low = …, high = …, log = true} or a list of values in place
            of a value. The default is the file of the algorithm in train/quadpend_train/studies/search/search_spaces.
        storage: File, or URL of a database such as sqlite:///search.db or postgresql://…, for the trials of all
            processes; the default is a file in OUT.
        jobs: Number of processes.
        cluster: Ray cluster on which Ray Tune makes the trials: auto, local or ray://HOST:PORT. It needs Ray.
        eval_freq: Timesteps between two evaluations of a trial; 0 for a 64th of the timesteps of a whole training.
        seed: Seed of the search.
    """
    from quadpend_train.reports import figures, search_plots
    from quadpend_train.studies.search import search_space
    from quadpend_train.studies.search import sweep as study_of_settings
    from quadpend_train.training.settings import read_settings

    start = read_settings(settings)
    searched = study_of_settings.Sweep(start, search_space.read_space(space, start), seconds, eval_freq, seed)
    study_of_settings.check_options(searched, trials, jobs)
    writable_folder(out)
    if cluster is None:
        study = study_of_settings.search(searched, trials, out, storage, jobs)
    else:
        if jobs != 1:
            raise ValueError("the cluster decides how many trials run at once: give no --jobs with --cluster")
        from quadpend_train.studies.search import ray_sweep

        study = ray_sweep.search(searched, trials, out, storage, cluster)
    lines = study_of_settings.write_results(study, searched, out)
    figure = search_plots.draw(study, "penalised RMSE (mm)", 1e3)
    figures.write_png(figure, out / study_of_settings.PICTURE)
    print("\n".join(lines))
    if advice := study_of_settings.advice(study):
        print(advice)
    best = shlex.quote(str(out / study_of_settings.BEST))
    print(f"Written: {', '.join(str(out / name) for name in study_of_settings.FILES)}")
    print(f"Train with these settings: quadpend train --settings {best}")


def ablate(
    names: tyro.conf.Positional[tuple[str, ...]] = (),
    seeds: int = 3,
    out: Path = Path("runs/ablations"),
    jobs: int = 1,
    cluster: str | None = None,
    document: Path | None = None,
) -> None:
    """Train with and without each part of a learner, and tabulate the differences.

    Args:
        names: Ablations, see train/quadpend_train/studies/ablations.py; the default is all of them.
        seeds: Number of training seeds, counted from 0.
        out: Folder for the runs and for ablations.json. Finished runs in it are not repeated.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that trains and evaluates instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        document: Markdown file in which to update the part "ablations".
    """
    from quadpend_train.common import documents
    from quadpend_train.studies import ablations

    run = executor(jobs, cluster)
    if cluster and (out.is_absolute() or ".." in out.parts):
        raise ValueError(f"with --cluster, out must be a relative path in the working directory, not {str(out)!r}")
    if document and names:
        raise ValueError("a document needs all ablations: give no names with --document")
    if document:
        documents.check(document, ["ablations"])
    writable_folder(out)
    outcomes = ablations.run(out, seeds, names or tuple(ablations.ABLATIONS), run)
    if document:
        ablations.document(outcomes, document)


def situation(
    policy: tyro.conf.Positional[str],
    scenarios: tuple[str, ...] = ("uncertain", "lagged", "noisy", "dryden_severe", "upset"),
    episodes: Episodes = 100,
    seed: Seed = VALIDATION_SEED,
    out: Path = Path("results/situation"),
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    document: Path | None = None,
) -> None:
    """Measure what a policy gains from observing its own situation, compared with the mean one.

    Args:
        policy: A policy trained with hybrid.situation = true, as in evaluate; several training seeds count as one.
        scenarios: Scenarios, as in evaluate.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        out: Folder for situation.md (the table), situation.json (its numbers) and situation.png.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results of the policy; only missing results are computed.
        document: Markdown file in which to update the part "situation".
    """
    from quadpend_train.common import documents
    from quadpend_train.common.provenance import provenance
    from quadpend_train.reports import figures
    from quadpend_train.studies import situation as study

    run = executor(jobs, cluster)
    if document:
        documents.check(document, ["situation"])
    writable_folder(out)
    check_folder(cache)
    measured = study.measure(policy, named_scenarios(scenarios), episodes, seed, cache, run)
    table, made = study.markdown(measured), provenance()
    study.save(measured, {**made, "episodes": episodes, "seed": seed}, out / "situation.json")
    write_text(out / "situation.md", table + "\n")
    figures.write_png(figures.interval_figure(study.gains(measured), study.LABEL), out / "situation.png")
    if document:
        command = f"`{shlex.join(made['command'])}`: {episodes} episodes in each scenario, seeds from {seed}."
        documents.fill(document, {"situation": f"{command}\n\n{table}"})
    make_console().print(table, highlight=False, markup=False)
    print(f"Written: {out}/situation.md, situation.json, situation.png")


def wind(
    models: tyro.conf.Positional[tuple[str, ...]] = (),
    out: Path = Path("results/wind"),
    seconds: float = 10.0,
    seed: Seed = 1,
) -> None:
    """Plot models of wind, and the effects of sensors and actuators.

    Args:
        models: Presets or kinds of wind, kinds of sensors or actuators, JSON with a kind and its settings, or a
            scenario file or module:factory of your own, whose wind is plotted. NAME=MODEL gives a model a name. The
            default is one model of each kind, as in docs/models.md.
        out: Folder for the figures, one PNG file for each model.
        seconds: Length of the time series, s.
        seed: Seed of the episode in the time series.
    """
    from quadpend_train.reports import model_plots

    if not (1.0 <= seconds <= 3600.0):
        raise ValueError(f"seconds must be from 1 to 3600, not {seconds:g}")
    named = [named_model(model) for model in models] or list(model_plots.GALLERY.items())
    plain = [name.replace(":", "_").replace(".", "_") if is_factory(name) else name for name, _ in named]
    names = [name if name.isidentifier() else f"model_{number}" for number, name in enumerate(plain)]
    if len(set(names)) < len(names):
        raise ValueError("two models have the same name: give each its own, as NAME=MODEL")
    writable_folder(out)
    for name in names:
        writable_file(out / f"{name}.png")
    for name, (_, model) in zip(names, named, strict=True):
        model_plots.draw(name, model, seconds, seed, out / f"{name}.png")
        print(f"Written: {out / name}.png")


def paper(gains: str = "paper", out: Path = Path("results/paper")) -> None:
    """Repeat the experiment of the paper and draw its Figures 4 to 10.

    Args:
        gains: Gains of the controller: "paper" or "matched".
        out: Folder for the figures (PNG, SVG) and merit.json.
    """
    writable_folder(out)
    from quadpend_baselines.paper import experiment, figures, figures_of_merit

    results = experiment.run(gains)
    figures.draw(results, out)
    numbers = json.dumps(figures_of_merit.compute_figures_of_merit(results), indent=1, allow_nan=False)
    write_text(out / "merit.json", numbers + "\n")
    print(f"Written: {out}/figure_4 to figure_10 (.png, .svg) and merit.json")
