"""The command `quadpend`."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from train.evaluate import TEST_SEED
from train.settings import TrainSettings, read_settings


@dataclass(frozen=True)
class Train:
    """Train a policy: `quadpend train --settings demo --out runs/demo --set.seed 3`."""

    set: TrainSettings
    """Settings that differ from the file's."""
    settings: str = "demo"
    """Name or path of the settings file."""
    out: Path = Path("runs/latest")
    """Folder of the run."""
    resume: Path | None = None
    """Folder of an interrupted run to go on with; nothing else counts then."""

    def run(self) -> None:
        """Train, and say where the model is."""
        from train.train import resume, train

        model = resume(self.resume) if self.resume else train(self.set, self.out)
        print(f"Trained model: {model}")


@dataclass(frozen=True)
class Evaluate:
    """Fly policies through the same episodes and compare them with the first."""

    policies: tuple[str, ...] = ("adrc-paper", "adrc-fixed")
    """adrc-paper, adrc-fixed, run folders or model files; NAME=… gives one a name."""
    scenarios: tuple[str, ...] = ("calm", "windy")
    """Names of scenarios, see `train.scenarios`."""
    episodes: int = 100
    """Episodes in each scenario."""
    seed: int = TEST_SEED
    """Of the first episode."""
    out: Path = Path("results")
    """Folder for comparison.json, comparison.md and comparison.png."""

    def run(self) -> None:
        """Compare, print the table and write the files."""
        from rich.console import Console

        from train import report
        from train.evaluate import compare
        from train.policies import load_policy

        named = [item.rpartition("=") for item in self.policies]
        policies = {name or path: load_policy(path) for name, _, path in named}
        comparison = compare(policies, self.scenarios, self.episodes, self.seed)
        comparison.save(self.out)
        (self.out / "comparison.md").write_text(report.markdown(comparison), encoding="utf-8")
        report.plot(comparison, self.out / "comparison.png")
        console = Console(width=None if sys.stdout.isatty() else 140)
        console.print(report.table(comparison))
        for sentence in report.verdicts(comparison):
            console.print(f"• {sentence}", highlight=False)
        console.print(f"Written: {self.out}/comparison.json, .md, .png", highlight=False)


@dataclass(frozen=True)
class Bench:
    """Measure speed, beside other environments in the same run."""

    out: Path | None = None
    """JSON file to write the figures to."""
    seconds: float = 0.5
    """Shortest time that a measurement takes."""
    training: bool = field(default=True)
    """Whether to measure PPO too."""

    def run(self) -> None:
        """Measure and print."""
        from benchmarks.speed import main

        main(self.out, self.seconds, self.training)


Commands = Annotated[Train, tyro.conf.subcommand("train")] | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; wrong input ends with one sentence and exit status 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
