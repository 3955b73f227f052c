"""The command `tune`: a search for gains of controllers."""

import json
from pathlib import Path

import tyro

from quadpend_train.cli.options import Episodes, Latency, Seed, Trials, named_scenarios


def tune(
    controllers: tyro.conf.Positional[tuple[str, ...]],
    trials: Trials = 150,
    episodes: Episodes = 48,
    seed: Seed = 0,
    out: Path = Path("results/tune"),
    scenarios: tuple[str, ...] = ("training",),
    vehicle: str | None = None,
    interface: str | None = None,
    latency: Latency = None,
    geometric: bool = False,
) -> None:
    """Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.

    The same command continues an interrupted search. It does not change the package: copy the gains into
    baselines/quadpend_baselines/gains.toml.

    Args:
        controllers: Controllers with tunable gains, see train/quadpend_train/search/search_spaces/gains.toml.
        trials: Trials of the search for each controller.
        episodes: Episodes in each scenario.
        seed: Random seed of the search.
        out: Folder for the trials, and for the gains that it finds, NAME.json.
        scenarios: Scenarios with the same vehicle and control period, for which the controllers are designed: names,
            TOML or JSON files, or JSON. "training" stands for all training scenarios.
        vehicle: Vehicle of all scenarios, as in evaluate.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
        latency: Latency in all scenarios, s, as in evaluate.
        geometric: Minimise the geometric mean of the errors over the scenarios, plus 1 to 2 m times the share of falls.
    """
    from quadpend_train.search import tuning

    chosen = [*named_scenarios(scenarios, vehicle, interface, latency=latency).values()]
    searches = [tuning.Search(name, chosen, episodes, geometric) for name in controllers]
    for search in searches:
        study = search.open(out / "trials.log", seed)
        print(json.dumps(tuning.tune(search, study, trials, out), indent=1))
