"""The command `card`: what a policy is, how it was trained, and how good it is."""

import inspect
import json as json_format
from collections.abc import Mapping
from dataclasses import asdict
from textwrap import fill
from typing import Any

import tyro

from quadpend_baselines import CONTROLLERS
from quadpend_baselines.gains import GAINS, TUNED
from quadpend_baselines.registry import DESCRIPTIONS
from quadpend_train.common.files import to_json_data
from quadpend_train.policies.loading import load_policy, policy_fingerprint, policy_names
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.policies.own import FactoryPolicy
from quadpend_train.training.settings import TrainSettings, settings_of_card, to_mapping

_NAME, _LINE = 14, 100  # characters of the names of the lines, and of the lines

Lines = dict[str, str]  # texts by the names of the lines


def card(policy: tyro.conf.Positional[str], json: bool = False) -> None:
    """Describe a policy: what it observes, how it was trained, and how good it is.

    Args:
        policy: A policy, as in evaluate; of a learned policy, one training seed (ppo-gain-scheduling-0).
        json: Print all data as JSON.
    """
    if len(seeds := policy_names(policy)) > 1:
        raise ValueError(f"{policy} has several training seeds: choose one of {', '.join(seeds)}")
    loaded = None if policy in CONTROLLERS else load_policy(policy)
    data, lines = _controller(policy) if loaded is None else _other(policy, loaded)
    if json:
        print(json_format.dumps(to_json_data(data), indent=1))
        return
    print(policy)
    opponent = "adrc-paper" if policy == "flatness" else "flatness"
    vehicle = f" --vehicle {data['vehicle']} --interface {data['interface']}" if data.get("vehicle") else ""
    lines["compare"] = f"quadpend evaluate {policy} {opponent} --scenarios windy{vehicle}"
    for name, text in lines.items():
        head = f"  {name:<{_NAME - 2}}"
        print(fill(text, _LINE, initial_indent=head, subsequent_indent=" " * _NAME, break_on_hyphens=False))


def _controller(name: str) -> tuple[dict[str, Any], Lines]:
    """Return the data and the lines about a classical controller."""
    gains = asdict(GAINS[name])
    data: dict[str, Any] = {"description": DESCRIPTIONS[name], "gains": gains}
    lines = {"description": DESCRIPTIONS[name], "gains": _pairs(_flat(gains))}
    if tuned := TUNED.get(name):
        data["tuning"] = tuned._asdict()
        lines["tuned"] = f"{tuned.command}: penalised RMSE {tuned.score:g} mm in the training scenarios"
    return data, lines


def _other(name: str, policy: Any) -> tuple[dict[str, Any], Lines]:
    """Return the data and the lines about a learned policy or a policy of the user's own code."""
    if isinstance(policy, MlpPolicy):
        return policy.card, _learned(policy)
    own = policy.factory if isinstance(policy, FactoryPolicy) else policy
    lines = {"type": type(own).__name__, "description": (inspect.getdoc(own) or "").partition("\n")[0]}
    if isinstance(policy, FactoryPolicy):
        lines |= {"factory": policy_fingerprint(name), "results": "cached" if policy.fingerprint else "not cached"}
    return lines, lines.copy()


def _learned(policy: MlpPolicy) -> Lines:
    card, hybrid = policy.card, policy.card["hybrid"]
    widths = [policy.layers[0][0].shape[0], *(weights.shape[1] for weights, _ in policy.layers)]
    scales = f", input scales {', '.join(f'{scale:g}' for scale in policy.input_scales)}" if policy.input_scales else ""
    memory = f", the latest {card['history']} of them" if card["history"] > 1 else ""
    memory += f", and its own latest {card['history_actions']} actions" if card["history_actions"] else ""
    estimates = f", as {hybrid['base_controller']} estimates it" if hybrid else ""
    sizes = " or ".join(map(str, policy.observation_sizes))
    lines = {
        "what": f"hybrid: {_pairs(hybrid)}" if hybrid else "network that acts alone",
        "network": f"{' → '.join(map(str, widths))}, {card['activation']}{scales}",
        "observes": f"the environment's observation of {sizes} numbers{estimates}{memory}",
    }
    if vehicle := card.get("vehicle"):
        lines["commands"] = f"{vehicle} by the interface {card.get('interface', 'wrench')}"
    if card["action_repeat"] > 1:
        lines["acts"] = f"every {card['action_repeat']} control steps"
    if {"settings", "score"} <= card.keys():
        lines |= _training(card)
    if provenance := card.get("provenance"):
        made = f"commit {provenance.get('commit')}, Python {provenance['python']}, {provenance['machine']}"
        lines |= {"provenance": made, "packages": _pairs(provenance["packages"], " ")}
    elif source := card.get("source"):
        lines["provenance"] = f"exported from {source}"
    return lines


def _training(card: Mapping[str, Any]) -> Lines:
    settings, score = card["settings"], card["score"]
    used = settings_of_card(card, "the policy")
    given, default = (
        _flat(json_format.loads(json_format.dumps(data)))
        for data in (to_mapping(used), to_mapping(TrainSettings(algo=used.algo)))
    )
    shown = {name: value for name, value in given.items() if value != default.get(name)}
    return {
        "trained": f"by {settings['algo'].upper()} in {', '.join(settings['scenarios'])}: {card['steps']} timesteps in"
        f" {card['seconds']:.0f} s, seed {card['seed']}",
        "settings": f"{_pairs(shown)}; the others have their default values",
        "score": f"survival {score['survival']:.1%}, penalised RMSE {1e3 * score['penalised_rmse']:.1f} mm, in"
        f" {settings['n_eval_episodes']} episodes of each training scenario",
    }


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return nested values as texts by their names on the command line, such as ``ppo.n_steps``."""
    flat: dict[str, str] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": str(value)}
    return flat


def _pairs(values: Mapping[str, Any], sign: str = "=") -> str:
    return ", ".join(f"{name}{sign}{value}" for name, value in values.items())
