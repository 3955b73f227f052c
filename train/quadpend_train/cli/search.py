"""The commands of the searches: `tune` for gains of controllers and `sweep` for settings of learners."""

import json
import shlex
from pathlib import Path

import tyro

from quadpend_train.cli.options import Episodes, Seed, Trials, named_scenarios


def tune(
    controllers: tyro.conf.Positional[tuple[str, ...]],
    trials: Trials = 150,
    episodes: Episodes = 48,
    seed: Seed = 0,
    out: Path = Path("results/tune"),
    scenarios: tuple[str, ...] = ("training",),
    vehicle: str | None = None,
    interface: str | None = None,
    geometric: bool = False,
    storage: str | None = None,
) -> None:
    """Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.

    The same command continues an interrupted search. In several terminals or on several machines, each with a --seed of
    its own, it searches with all of them, if it has a --storage that all can open. The command does not change the
    package: copy the gains into baselines/quadpend_baselines/gains.toml.

    Args:
        controllers: Controllers with tunable gains, see train/quadpend_train/search/search_spaces/gains.toml.
        trials: Trials of the search for each controller.
        episodes: Episodes in each scenario.
        seed: Random seed of the search.
        out: Folder for the gains that it finds, NAME.json, and a picture of the search, NAME.png.
        scenarios: Scenarios with the same vehicle and control period, for which the controllers are designed: names,
            TOML or JSON files, or JSON. "training" stands for all training scenarios.
        vehicle: Vehicle of all scenarios, as in evaluate.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
        geometric: Minimise the geometric mean of the errors over the scenarios, plus 1 to 2 m times the share of falls.
        storage: File, or URL of a database such as sqlite:///search.db or postgresql://…, for the trials of all
            processes; the default is a file in OUT. Opening a storage executes code that it contains: use only storages
            that you trust.
    """
    from quadpend_train.search import shared, tuning

    chosen = [*named_scenarios(scenarios, vehicle, interface).values()]
    searches = [tuning.Search(name, chosen, episodes, geometric) for name in controllers]
    out.mkdir(parents=True, exist_ok=True)
    for search in searches:
        study = search.open(storage or str(out / "trials.log"), seed)
        print(json.dumps(tuning.tune(search, study, trials, out), indent=1))
        shared.draw(study, "loss (mm)", out / f"{search.name}.png")


def sweep(
    settings: tyro.conf.Positional[str],
    trials: Trials = 32,
    seconds: float = 60.0,
    out: Path = Path("results/sweep"),
    space: Path | None = None,
    storage: str | None = None,
    jobs: int = 1,
    seed: Seed = 0,
) -> None:
    """Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.

    The same command continues an interrupted search. In several terminals or on several machines, each with a --seed of
    its own, it searches with all of them, if it has a --storage that all can open, and an --out for each machine.
    `quadpend train --settings OUT/best.json` trains with the settings that it finds.

    Args:
        settings: Settings from which the search starts, as --settings of train; the first trial has them.
        trials: Trials of the search, those included that are stopped early since the median of the others is better.
        seconds: Duration of the training of a trial, s.
        out: Folder for best.json (the settings), trials.csv, sweep.png and the trainings.
        space: Search space, a settings file with a range {low = …, high = …, log = true} or a list of values in place
            of a value. The default is the file of the algorithm in train/quadpend_train/search/search_spaces.
        storage: File or URL of a database for the trials of all processes, as in tune.
        jobs: Number of processes.
        seed: Random seed of the search.
    """
    from quadpend_train.search import shared
    from quadpend_train.search import sweep as study_of_settings
    from quadpend_train.training.settings import read_settings

    out.mkdir(parents=True, exist_ok=True)
    start = read_settings(settings)
    ranges, values = study_of_settings.read_space(space, start)
    where = storage or str(out / "trials.log")
    searched = study_of_settings.Sweep(start, ranges, values, seconds, out, where, seed)
    study = study_of_settings.search(searched, trials, jobs)
    lines = study_of_settings.write_results(study, searched)
    shared.draw(study, "penalised RMSE (m)", out / study_of_settings.PICTURE)
    print("\n".join(lines))
    print(f"Written: {', '.join(str(out / name) for name in study_of_settings.FILES)}")
    best = shlex.quote(str(out / study_of_settings.BEST))
    print(f"Train with these settings: quadpend train --settings {best}")
