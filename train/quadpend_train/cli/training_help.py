"""What `quadpend train --help` prints, on two screens: the presets, and one sentence about each option."""

import inspect
import re
import shutil
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import is_dataclass
from typing import Any

from quadpend_train.cli.training import default_settings, train
from quadpend_train.common.declarations import meanings
from quadpend_train.training.settings import TrainSettings, presets

_NARROW, _WIDE = 80, 120  # characters of a line


def help_text(options: Sequence[str]) -> str:
    """Return the help, whose defaults are those of the settings among the options."""
    run: TrainSettings = default_settings([option for option in options if option not in ("--help", "-h")])["run"]
    settings = [*_settings(run)]
    if run.algo != "apg":
        settings.append(("--apg.…", "Settings of APG: quadpend train --algo apg --help."))
    tables = {"": settings} | {name: [*_settings(table, name)] for name, table in _tables(run)}
    return "\n".join(
        [
            f"usage: quadpend train [OPTIONS]\n\n{_sentence(inspect.getdoc(train) or '')}",
            "\npresets, for --settings:",
            *_rows((name, _sentence(text)) for name, text in presets().items()),
            "\noptions:",
            *_rows(_arguments()),
            f"\nsettings, with their defaults here (algo {run.algo}; other presets have others):",
            *(line for rows in tables.values() for line in _rows(rows)),
            "\ndocs/reference/settings.md says more about each setting.",
        ]
    )


def _arguments() -> Iterable[tuple[str, str]]:
    """Yield the options of the command itself."""
    docs = inspect.getdoc(train) or ""
    for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", docs, re.MULTILINE):
        if name != "run":
            yield f"--{name}", _sentence(text)


def _tables(run: TrainSettings) -> Iterable[tuple[str, Any]]:
    """Yield the tables of the settings that the algorithm has."""
    for name, value in vars(run).items():
        if is_dataclass(value) and (name != "apg" or run.algo == "apg"):
            yield name, value


def _settings(values: Any, table: str = "") -> Iterable[tuple[str, str]]:
    """Yield the settings of a table without those of the tables in it."""
    texts, prefix = meanings(type(values)), f"{table}." if table else ""
    for name, value in vars(values).items():
        if not is_dataclass(value) and name != "arguments":  # which --set sets
            option = f"--{prefix}{name}".replace("_", "-")
            yield f"{option} {_default(name, value)}".rstrip(), _sentence(texts[name])


def _default(name: str, value: Any) -> str:
    if name == "scenarios":
        return " ".join(scenario.name for scenario in value) if len(value) == 1 else "…"
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _sentence(text: str) -> str:
    """Return the first sentence of a text."""
    return re.split(r"(?<=\.) ", " ".join(text.split()), maxsplit=1)[0]


def _rows(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Return lines with names on the left and texts on the right."""
    items = list(rows)
    width = 2 + max(len(name) for name, _ in items)
    columns = min(max(shutil.get_terminal_size((100, 24)).columns, _NARROW), _WIDE)
    return [
        line
        for name, text in items
        for line in textwrap.wrap(
            f"{name:<{width}}{text}", columns, initial_indent="  ", subsequent_indent=" " * (width + 2)
        )
    ]
