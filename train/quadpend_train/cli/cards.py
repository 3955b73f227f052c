"""The command `card`: what a policy is, how it was trained, and how good it is."""

import json as json_format
from collections.abc import Mapping
from dataclasses import asdict
from textwrap import fill
from typing import Any

import tyro

from quadpend_baselines import CONTROLLERS
from quadpend_baselines.gains import DESCRIPTIONS, tuned
from quadpend_baselines.registry import controller_from_text, gains_file
from quadpend_gym.core.nested import flat
from quadpend_gym.tasks.observation import PRESETS
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import TrainSettings, settings_of_card, to_mapping

_NAME, _LINE = 14, 100  # characters of the names of the lines, and of the lines


def card(policy: tyro.conf.Positional[str], json: bool = False) -> None:
    """Describe a policy: what it observes, how it was trained, and how good it is.

    Args:
        policy: A policy, as in evaluate.
        json: Print all data as JSON.
    """
    data, lines = _controller(policy) if policy in CONTROLLERS or gains_file(policy) else _learned(policy)
    if json:
        print(json_format.dumps(data, indent=1))
        return
    opponent = "adrc-paper" if policy == "flatness" else "flatness"
    vehicle = f" --vehicle {data['vehicle']} --interface {data['interface']}" if data.get("vehicle") else ""
    lines["compare"] = f"quadpend evaluate {policy} {opponent} --scenarios windy{vehicle}"
    print(policy)
    for name, text in lines.items():
        head = f"  {name:<{_NAME - 2}}"
        print(fill(text, _LINE, initial_indent=head, subsequent_indent=" " * _NAME, break_on_hyphens=False))


def _controller(text: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the data and the lines about a classical controller, also one with the gains of a file."""
    made = controller_from_text(text)
    description = DESCRIPTIONS[text.partition(":")[0]]
    data: dict[str, Any] = {"description": description, "gains": asdict(made.gains)}
    lines = {"description": description, "gains": _pairs(flat(data["gains"]))}
    if search := tuned().get(text):
        data["tuning"] = search._asdict()
        lines["tuned"] = f"{search.command}: penalised RMSE {search.score:g} mm in the training scenarios"
    return data, lines


def _learned(name: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the card of a learned policy, and the lines about it."""
    policy = load_policy(name)
    if not isinstance(policy, MlpPolicy):
        raise ValueError(f"{name} has no card: only policy files have one")
    card, hybrid, score = policy.card, policy.card["hybrid"], policy.card.get("score")
    widths = [policy.layers[0][0].shape[0], *(weights.shape[1] for weights, _ in policy.layers)]
    lines = {
        "what": f"hybrid: {_pairs(hybrid)}" if hybrid else "network that acts alone",
        "network": f"{' → '.join(map(str, widths))}, {card['activation']}",
        "observes": f"{' or '.join(str(layout.size) for layout in policy.layouts)} numbers of the environment"
        + "".join(f"; {', '.join(layout)}" for layout in policy.layouts if layout not in PRESETS.values())
        + (f", as {hybrid['base_controller']} estimates it" if hybrid else ""),
    }
    if score and "settings" in card:
        settings = settings_of_card(card, name)
        default = flat(to_mapping(TrainSettings(algo=settings.algo)))
        changed = {key: value for key, value in flat(to_mapping(settings)).items() if value != default.get(key)}
        changed.pop("scenarios", None)
        names = [scenario.name for scenario in settings.scenarios]
        lines |= {
            "trained": f"by {settings.algo.upper()} in {', '.join(names)}: {card['steps']} timesteps in"
            f" {card['seconds']:.0f} s, seed {card['seed']}",
            "settings": f"{_pairs(changed)}; the others have their default values",
            "score": f"survival {score['survival']:.1%}, penalised RMSE {1e3 * score['penalised_rmse']:.1f} mm, in"
            f" {settings.n_eval_episodes} episodes of each training scenario",
        }
    if made := card.get("provenance"):
        packages = ", ".join(f"{name} {version}" for name, version in made["packages"].items())
        lines["provenance"] = f"commit {made['commit']}, Python {made['python']}, {made['machine']}, {packages}"
    elif source := card.get("source"):
        lines["provenance"] = f"exported from {source}"
    return card, lines


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value}" for name, value in values.items())
