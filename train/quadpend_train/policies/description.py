"""Check the fields of a card that describe a policy and its training, when the policy is loaded.

A report or `quadpend card` reads them long after the policy has flown; a damaged card is refused before.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

_LARGEST = 10_000_000  # control steps or observations; NumPy counts control steps in 64 bits
_TRAINED = ("steps", "best_at", "seconds", "seed", "curve")  # fields of a card with settings and a score
_USED = ("algo", "scenarios", "n_eval_episodes")  # settings on such a card
_MADE = ("python", "machine", "packages")  # fields of the provenance


def check_description(card: dict[str, Any]) -> None:
    """Check the description of a policy on its card.

    Args:
        card: The card, with the current names.

    Raises:
        ValueError: If a field is not what it says.
    """
    for name in ("action_repeat", "history", "history_actions"):
        _check(card, name, lambda value: _is_count(value, _LARGEST), f"an integer from 0 to {_LARGEST}")
    for name in ("steps", "best_at", "seed"):
        _check(card, name, _is_count, "an integer of at least 0")
    _check(card, "seconds", _is_positive, "a finite number of at least 0")
    _check(card, "source", lambda value: isinstance(value, str), "a text")
    _check(card, "curve", _is_curve, "a list of [steps, seconds, survival, penalised RMSE] with increasing steps")
    _check(card, "score", _is_final_score, "a mapping with survival from 0 to 1 and penalised_rmse of at least 0")
    _check(card, "scenarios", _is_texts, "a mapping from at least one scenario to its hash")
    for name in ("settings", "provenance"):
        _check(card, name, lambda value: isinstance(value, dict), "a mapping")
    _check(card.get("settings", {}), "scenarios", _are_scenarios, "at least one scenario", "settings.")
    if {"settings", "score"} <= card.keys():
        _require(card, _TRAINED, "")
        _require(card["settings"], _USED, "settings.")
        _check(card["settings"], "algo", lambda value: isinstance(value, str), "a text", "settings.")
    if made := card.get("provenance"):
        _require(made, _MADE, "provenance.")
        _check(made, "packages", _is_texts, "a mapping from packages to versions", "provenance.")
        steps = "a list of integers of at least 0"
        _check(made, "continued_at", _are_counts, steps, "provenance.")
        start = "a mapping with the texts policy and sha256"
        _check(made, "start_from", _is_start, start, "provenance.")


def _check(values: dict[str, Any], name: str, fits: Callable[[Any], bool], wanted: str, prefix: str = "") -> None:
    if name in values and not fits(values[name]):
        shown = repr(values[name])
        raise ValueError(f"{prefix}{name} must be {wanted}, not {shown if len(shown) < 60 else shown[:60] + '…'}")


def _require(values: dict[str, Any], names: tuple[str, ...], prefix: str) -> None:
    if missing := [name for name in names if name not in values]:
        raise ValueError(f"the card must have {prefix}{missing[0]}")


def _is_count(value: Any, largest: int = 2**63 - 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= largest


def _is_positive(value: Any, largest: float = 1e300) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and 0.0 <= value <= largest  # nan is not


def _is_curve(value: Any) -> bool:
    rows = isinstance(value, list) and all(isinstance(row, list) and len(row) == 4 for row in value)
    return rows and all(map(is_score, value)) and all(one[0] < other[0] for one, other in pairwise(value))


def is_score(row: Sequence[Any]) -> bool:
    """Return whether these are the timesteps, the seconds, the survival and the penalised RMSE (m) of an evaluation."""
    return _is_count(row[0]) and all(map(_is_positive, row[1:])) and row[2] <= 1.0 and row[3] <= 1.0


def _is_final_score(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and _is_positive(value.get("survival"), 1.0)
        and _is_positive(value.get("penalised_rmse"))
    )


def _is_texts(value: Any) -> bool:
    return isinstance(value, dict) and bool(value) and all(isinstance(text, str) for text in value.values())


def _are_scenarios(value: Any) -> bool:
    return bool(value) and (
        isinstance(value, str)
        or (isinstance(value, list | tuple) and all(isinstance(item, str | dict) and item for item in value))
    )


def _are_counts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_count, value))


def _is_start(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(value.get(name), str) for name in ("policy", "sha256"))
