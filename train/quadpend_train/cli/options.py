"""Helpers of several commands: parse NAME=POLICY, NAME=SCENARIO and NAME=MODEL, and make a console for tables.

The options `--vehicle` and `--interface` apply to all scenarios of a command, see `Scenario.with_vehicle`.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quadpend_gym.scenarios import expand_sets, with_changes


def named_policies(policies: Sequence[str]) -> dict[str, str]:
    """Return policies by name.

    Args:
        policies: Policies, or NAME=POLICY.

    Raises:
        ValueError: If two policies have the same name.
    """
    named = dict(map(_split_name, policies))
    if len(named) < len(policies):
        raise ValueError("two policies have the same name: give each its own, as NAME=POLICY")
    return named


def named_scenarios(
    scenarios: Sequence[str], vehicle: str | None = None, interface: str | None = None
) -> dict[str, str]:
    """Return scenarios by name, with the members of sets in place of the sets. Duplicates count once.

    Args:
        scenarios: Scenarios, sets of them, or NAME=SCENARIO.
        vehicle: Vehicle of all scenarios, the name of a preset or a TOML file; None: their own.
        interface: Command interface of all scenarios; None: their own.

    Raises:
        ValueError: If two different scenarios have the same name.
    """
    label = Path(vehicle).stem if vehicle else None
    pairs = [
        (with_changes(name, label, interface), with_changes(value, vehicle, interface))
        for name, value in map(named_model, expand_sets(scenarios))
    ]
    if len(dict(pairs)) < len(set(pairs)):
        raise ValueError("two scenarios have the same name: give each its own, as NAME=SCENARIO")
    return dict(pairs)


def named_model(model: str) -> tuple[str, str]:
    """Return the name and the value of MODEL or NAME=MODEL; the name of a file is its stem.

    Args:
        model: Name of a preset or scenario, path of a file, or JSON.
    """
    name, value = _split_name(model)
    return (Path(value).stem if name == value and not value.lstrip().startswith("{") else name), value


def _split_name(text: str) -> tuple[str, str]:
    """Split NAME=VALUE. A name contains no slash, while a path may contain an equals sign."""
    name, sign, value = text.partition("=")
    return (name, value) if sign and "/" not in name else (text, text)


def make_console() -> Any:
    """Return a console for tables, without markup; it is 150 characters wide if the output is not a terminal."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 150, emoji=False, markup=False)
