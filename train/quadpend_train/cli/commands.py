"""What the commands of `quadpend` do: functions whose parameters are their options, as `cli` offers them.

Heavy imports wait until a command needs them.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from quadpend_train.evaluation.cache import FOLDER
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.scenarios import expand, find_scenario, scenario_hash
from quadpend_train.training.settings import TrainSettings, from_mapping, read_settings

DEFAULT_SETTINGS = "demo"
DEFAULT_OUT = Path("runs/latest")
_FEW, _ROWS = 16, 40  # sentences and rows of a table that a terminal takes; the files have them all


def train(
    run: Annotated[TrainSettings, tyro.conf.arg(name="")],
    settings: str = DEFAULT_SETTINGS,
    out: Path = DEFAULT_OUT,
    resume: Path | None = None,
) -> None:
    """Train PPO, SAC or TQC.

    Args:
        run: Settings that differ from those of the file.
        settings: Settings file: a name in train/quadpend_train/training/presets, the path of a TOML or JSON file, or a policy file (.npz),
            whose card has those it was trained with. Without it --algo chooses: ppo, sac or tqc.
        out: Folder of the run.
        resume: Folder of an interrupted run to go on with, under the settings in it.
    """
    from quadpend_train.training import train as training

    if resume and (out != DEFAULT_OUT or run != read_settings(settings)):
        raise ValueError("--resume goes on with the settings and in the folder of the run: give no others")
    policy = training.resume(resume) if resume else training.train(run, out)
    print(f"Trained policy: {policy}")


def export(model: Path, out: Path | None = None) -> None:
    """Turn a model that Stable-Baselines3 or sb3-contrib has saved into a policy file that executes nothing.

    Loading the model executes code that is in it: export only files whose origin you trust.

    Args:
        model: File (.zip) saved by PPO, SAC or TQC, whose policy takes the observation as it is.
        out: Policy file; by default beside the model, with the ending .npz.
    """
    from quadpend_train.policies.export import export_zip

    path = out or model.with_suffix(".npz")
    if path.exists():
        raise FileExistsError(f"{path} is there already: choose another file with --out")
    export_zip(model, source=model.name).save(path)
    print(f"Written: {path}")


def card(policy: tyro.conf.Positional[str]) -> None:
    """Print where a learned policy comes from.

    Args:
        policy: A policy of this package (ppo-gain-scheduling-0), a run folder or a policy file.
    """
    import json

    from quadpend_train.policies.loading import policy_file
    from quadpend_train.policies.mlp_policy import MlpPolicy

    print(json.dumps(MlpPolicy.load(policy_file(policy)).card, indent=1))


def reproduce(policy: tyro.conf.Positional[str], out: Path = Path("runs/reproduced")) -> None:
    """Train a learned policy again, from its card, and say whether the weights are the same.

    Args:
        policy: A policy of this package (ppo-gain-scheduling-0), a run folder or a policy file.
        out: Folder of the new run.
    """
    from quadpend_train.policies.loading import policy_file
    from quadpend_train.policies.mlp_policy import MlpPolicy, weight_difference
    from quadpend_train.training import train as training

    before = MlpPolicy.load(policy_file(policy))
    if missing := [name for name in ("settings", "scenarios", "provenance") if name not in before.card]:
        raise ValueError(f"the card of {policy} has no {missing[0]}: it was exported, not trained here")
    for name, flown in before.card["scenarios"].items():
        if scenario_hash(find_scenario(name)) != flown:
            raise ValueError(f"the scenario {name} is another than the one {policy} was trained in")
    after = MlpPolicy.load(training.train(from_mapping(before.card["settings"], f"the card of {policy}"), out))
    if largest := weight_difference(before, after):
        print(f"The weights differ by up to {largest:g}: expect that on another machine or with other versions.")
        print(f"The card's: {before.card['provenance']['machine']}, {before.card['provenance']['packages']}")
        sys.exit(1)
    print("The same weights.")


def evaluate(
    policies: tuple[str, ...] = ("adrc-paper", "adrc-matched"),
    scenarios: tuple[str, ...] = ("calm", "windy"),
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    out: Path = Path("results"),
    jobs: int = 1,
    store: Path = FOLDER,
    fresh: bool = False,
    robustness: int = 0,
    replay: int = 2,
    document: Path | None = None,
) -> None:
    """Fly policies through the same episodes and compare them with the first.

    Args:
        policies: Classical controllers (adrc-paper, …), run folders or model files; NAME=POLICY gives one a name, and
            NAME=POLICY,POLICY,… puts the training seeds of one learner under it.
        scenarios: Scenarios by name, TOML or JSON file, or as JSON, see train/quadpend_train/scenarios; NAME=SCENARIO gives one a
            name; test and training stand for all of these sets.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Gains are tuned from 2000000 on, and the published results are from 1000000 on:
            leave those alone while you work on a policy.
        out: Folder for report.html, comparison.json, .csv, .md and .png, and the pictures of robustness.
        jobs: Processes that fly; the result is the same.
        store: Folder where flights are kept, so that only those missing are flown.
        fresh: Fly all of them again.
        robustness: Episodes at each value of the axes of trouble, see train/quadpend_train/studies/perturbations.py, of a learner the first seed's; 0:
            no curves and no maps.
        replay: Episodes of each scenario that the page can replay; 0: none.
        document: Markdown file whose generated parts to fill in.
    """
    from quadpend_gym.core.validation import check_int
    from quadpend_train.common import documents
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.evaluation.leaderboard import leaderboard
    from quadpend_train.policies.loading import load_policies, policy_names
    from quadpend_train.reports import learning_curves, results, tables
    from quadpend_train.reports.replay import recorded
    from quadpend_train.studies.robustness import measure_robustness

    check_int(replay, "replay", 0)
    named = named_policies(policies)
    if document:
        documents.check(document, results.PARTS)
    comparison = compare(named, _scenarios(scenarios), episodes, seed, store, fresh, jobs)
    endured = (
        measure_robustness(
            {name: policy_names(policy)[0] for name, policy in named.items()},
            episodes=robustness,
            seed=seed,
            folder=store,
            fresh=fresh,
            jobs=jobs,
        )
        if robustness
        else None
    )
    curves = learning_curves.of({name: load_policies(policy) for name, policy in named.items()})
    files = results.write(comparison, endured, out, curves, recorded(comparison, named, replay))
    if document:
        results.document(comparison, endured, document)
    console = _console()
    if len(comparison.results) <= _ROWS:
        console.print(tables.table(comparison))
    if len(sentences := tables.verdicts(comparison)) <= _FEW:
        for sentence in sentences:
            console.print(f"• {sentence}", highlight=False)
    if len(comparison.policies) > 1 and len(comparison.scenarios) > 1:
        console.print(tables.leaderboard_table(leaderboard(comparison)))
    console.print(f"Written: {out}/{', '.join(files)}", highlight=False)


def compare(
    policies: tyro.conf.Positional[tuple[str, str]],
    scenarios: tuple[str, ...] = ("test",),
    episodes: int = 200,
    seed: int = VALIDATION_SEED,
    jobs: int = 1,
    store: Path = FOLDER,
    fresh: bool = False,
) -> None:
    """Say in one sentence which of two policies wins where, by how much, and how sure that is.

    A scenario is won by survival, or else by the RMSE of the episodes that both survive, if the difference is
    significant at 5 % after Holm's correction for the number of tests.

    Args:
        policies: Two, as in evaluate.
        scenarios: As in evaluate.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Gains are tuned from 2000000 on, and the published results are from 1000000 on:
            leave those alone while you work on a policy.
        jobs: Processes that fly; the result is the same.
        store: Folder where flights are kept, so that only those missing are flown.
        fresh: Fly all of them again.
    """
    from quadpend_train.evaluation.comparison import compare as fly
    from quadpend_train.evaluation.pairwise import compare_pair as fight
    from quadpend_train.reports import tables

    named = named_policies(policies)
    fought = fight(fly(named, _scenarios(scenarios), episodes, seed, store, fresh, jobs), *named)
    console = _console()
    console.print(fought.sentence(), highlight=False)
    console.print(tables.duel_table(fought))


def tune(
    controllers: tyro.conf.Positional[tuple[str, ...]],
    trials: int = 150,
    episodes: int = 48,
    seed: int = 0,
    out: Path = Path("results/tune"),
) -> None:
    """Tune classical controllers on the training scenarios: penalised RMSE, so survival first, then accuracy.

    Interrupted, it goes on where it was. What it finds is put into baselines/quadpend_baselines/gains.py by hand.

    Args:
        controllers: Of those that have something to tune, see .train/quadpend_train/studies/tuning.py
        trials: Gains to try for each.
        episodes: Episodes in each scenario.
        seed: Of the search.
        out: Folder for the journal of the search and for what is found, NAME.json.
    """
    import json

    from quadpend_train.studies import tuning as tuning

    for name in controllers:
        print(json.dumps(tuning.tune(name, trials, episodes, seed, out), indent=1))


def _console() -> Any:
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 150)


def named_policies(policies: Sequence[str]) -> dict[str, str]:
    """Policies by name."""
    named = dict(map(_named, policies))
    if len(named) < len(policies):
        raise ValueError("two policies have the same name: give each its own, as NAME=POLICY")
    return named


def _scenarios(scenarios: Sequence[str]) -> dict[str, str]:
    """Scenarios by name, those of sets too; the same one twice counts once."""
    wanted = set(map(_labelled, expand(scenarios)))
    flown = dict(map(_labelled, expand(scenarios)))
    if len(flown) < len(wanted):
        raise ValueError("two scenarios have the same name: give each its own, as NAME=SCENARIO")
    return flown


def _named(policy: str) -> tuple[str, str]:
    """Name and policy of NAME=POLICY; a name has no slash, a path may have an equals sign."""
    name, sign, rest = policy.partition("=")
    return (name, rest) if sign and "/" not in name else (policy, policy)


def _labelled(scenario: str) -> tuple[str, str]:
    """Name and scenario of NAME=SCENARIO; a file is called by its stem."""
    name, rest = _named(scenario)
    return (Path(rest).stem if name == rest and not rest.lstrip().startswith("{") else name), rest


def ablate(
    names: tyro.conf.Positional[tuple[str, ...]] = (),
    seeds: int = 3,
    out: Path = Path("runs/ablations"),
    document: Path | None = None,
) -> None:
    """Train with and without each part of a learner, and tabulate what it is worth.

    Args:
        names: Of ablations, see train/quadpend_train/studies/ablations.py; all of them without.
        seeds: Training seeds, from 0 on.
        out: Folder of the runs, of which those that are there are not trained again, and of ablations.json.
        document: Markdown file whose part "ablations" to fill in.
    """
    from quadpend_train.common import documents
    from quadpend_train.studies import ablations

    if seeds < 1:
        raise ValueError(f"seeds must be at least 1, not {seeds}")
    if document and names:
        raise ValueError("a document takes all ablations: give no names")
    if document:
        documents.check(document, ["ablations"])
    outcomes = ablations.run(out, seeds, names or tuple(ablations.ABLATIONS))
    if document:
        ablations.document(outcomes, document)


def wind(
    models: tuple[str, ...] = (),
    out: Path = Path("results/wind"),
    seconds: float = 10.0,
    seed: int = 1,
) -> None:
    """Draw what one trains in: a wind's series, histogram and spectrum beside theory; what sensors and actuators do.

    Args:
        models: Presets or kinds of wind, kinds of sensors or actuators, JSON with a kind and its settings, or the file
            of a scenario, for its wind; NAME=MODEL gives one a name. Without, one of each kind, as in docs/models.md.
        out: Folder for the pictures, one PNG for each model.
        seconds: How much of the series to show.
        seed: Of the episode shown.
    """
    from quadpend_train.reports import model_plots

    if not (1.0 <= seconds <= 3600.0):
        raise ValueError(f"seconds must be from 1 to 3600, not {seconds:g}")
    if seed < 0:
        raise ValueError(f"seed must be at least 0, not {seed}")
    named = [_labelled(model) for model in models] or list(model_plots.GALLERY.items())
    names = [name if name.isidentifier() else f"model_{number}" for number, (name, _) in enumerate(named)]
    if len(set(names)) < len(names):
        raise ValueError("two models have the same name: give each its own, as NAME=MODEL")
    out.mkdir(parents=True, exist_ok=True)
    for name, (_, model) in zip(names, named, strict=True):
        model_plots.draw(name, model, seconds, seed, out / f"{name}.png")
        print(f"Written: {out / name}.png")


def paper(gains: str = "paper", out: Path = Path("results/paper"), ablations: bool = False) -> None:
    """Repeat the paper's experiment and draw its Figures 4 to 10.

    Args:
        gains: Gains of the controller: paper, or matched.
        out: Folder for the figures (PNG, SVG) and merit.json.
        ablations: Instead, tabulate when the controller fails and what cures it: ablations.md and ablations.png.
    """
    import json

    out.mkdir(parents=True, exist_ok=True)
    if ablations:
        _ablate(out)
        return
    from quadpend_baselines.paper import experiment, figures, figures_of_merit

    flown = experiment.run(gains)
    figures.draw(flown, out)
    numbers = json.dumps(figures_of_merit.compute_figures_of_merit(flown), indent=1, allow_nan=False)
    (out / "merit.json").write_text(numbers + "\n", encoding="utf-8")
    print(f"Written: {out}/figure_4 to figure_10 (.png, .svg) and merit.json")


def _ablate(out: Path) -> None:
    from quadpend_baselines.paper import ablation_plots, ablations

    results = ablations.run()
    (out / "ablations.md").write_text(ablations.markdown(results), encoding="utf-8")
    ablation_plots.draw(results, out / "ablations.png")
    print(ablations.markdown(results) + f"Written: {out}/ablations.md, ablations.png")
