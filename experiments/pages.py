"""What the experiments share: their options, and the generated parts of the pages of docs/."""

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.statistics import Interval

README = Path(__file__).parents[1] / "README.md"
DOCS = README.parent / "docs"
CACHE = Path("results/cache")
POLICIES = Path(__file__).parent / "policies"  # further training seeds of the published tables


def options(
    description: str | None, episodes: int, policies: Sequence[str] = (), out: Path | None = None
) -> argparse.Namespace:
    """Return the options of a script: ``episodes``, ``seed``, ``jobs``, and if given ``policies`` and ``out``."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if policies:
        parser.add_argument("policies", nargs="*", default=policies, help="NAME=POLICY or POLICY")
    if out:
        parser.add_argument("--out", type=Path, default=out, help="folder of figures and tables")
    parser.add_argument("--episodes", type=int, default=episodes, help="episodes in each scenario")
    parser.add_argument("--seed", type=int, default=TEST_SEED, help="seed of the first episode")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes; the results do not depend on it")
    return parser.parse_args()


def training_seeds(name: str) -> str:
    """Return a policy as `compare` takes it: a learner of the published tables with all its training seeds."""
    others = sorted(map(str, POLICIES.glob(f"{name}-[1-9].npz")))
    return f"{name}={','.join([f'{name}-0', *others])}" if others else name


def fill(path: Path, parts: Mapping[str, str]) -> None:
    """Replace the text between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; the rest stays."""
    text = path.read_text(encoding="utf-8")
    for name, part in parts.items():
        pattern = re.compile(rf"(<!-- begin {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)", re.DOTALL)
        pieces = pattern.split(text)
        if len(pieces) != 4:
            raise ValueError(f"{path} must contain <!-- begin {name} --> … <!-- end {name} --> exactly once")
        before, begin, end, after = pieces
        text = f"{before}{begin}\n{part.strip()}\n\n{end}{after}"
    write_text(path, text)


def made_by(experiment: str, episodes: int, seed: int) -> str:
    """Return the line above a table: the command, the number of episodes and the seed of the first one."""
    return f"`python -m experiments.{experiment}`: {episodes} episodes in each scenario, seeds from {seed}."


def with_survival(number: str, summary: Mapping[str, Interval]) -> str:
    """Return a number, followed by the survival if that is below 100 %."""
    survival = summary["survival"].value
    return number if survival == 100.0 else f"{number} ({survival:.3g} %)"
