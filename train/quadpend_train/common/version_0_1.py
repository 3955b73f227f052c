"""Translate the names of version 0.1 to the current names.

Version 0.1 wrote flat training settings, policy files of the format ``quadpend policy 1`` and run folders with an
``origin.json``. Its learned policies and presets had other names. The functions of this module are called where
settings, policy files, run folders and names of policies and presets are read. All other code uses the current names
only.
"""

import re
from pathlib import Path
from typing import Any

POLICY_FORMAT = "quadpend policy 1"
PROVENANCE = "origin.json"

# Table of the current settings: {name in version 0.1: current name}
_NAMES = {
    "": {
        "scenario": "scenarios",
        "total_steps": "total_timesteps",
        "episode_steps": "max_episode_steps",
        "discount": "gamma",
        "hidden": "net_arch",
        "activation": "activation_fn",
        "exploration_steps": "sde_sample_freq",
        "checkpoint_steps": "save_freq",
        "evaluation_steps": "eval_freq",
        "evaluation_episodes": "n_eval_episodes",
        "threads": "num_threads",
    },
    "ppo": {
        "rollout_steps": "n_steps",
        "epochs": "n_epochs",
        "entropy_coefficient": "ent_coef",
        "initial_log_std": "log_std_init",
        "critic_steps": "critic_warmup_steps",
    },
    "sac": {"initial_entropy_coefficient": "ent_coef_init"},
}
# Flat settings of version 0.1 that are now in the table ``hybrid``
_HYBRID = {
    "companion": "base_controller",
    "steers": "mode",
    "authority": "action_scale",
    "caution": "fallback_gain",
    "hold": "action_repeat",
    "paired": "baseline_relative_reward",
    "fall_cost": "failure_penalty",
    "imitation_steps": "imitation_timesteps",
}
_MODES = {"alone": "estimate_only", "action": "residual_action", "pace": "bandwidth_scheduling"}
_VIEW = ("companion", "steers", "authority", "caution", "hold", "history", "history_actions")
_OLD_POLICY = re.compile(r"(ppo|sac)-pace(-hover)?(-\d+)?")


def current_name(name: str) -> str:
    """Return the current name of a policy or preset, such as ``ppo-gain-scheduling-0`` for ``ppo-pace-0``."""
    match = _OLD_POLICY.fullmatch(name)
    return "{}-gain-scheduling{}{}".format(*match.groups("")) if match else name


def provenance_file(folder: Path, name: str) -> Path:
    """Return the provenance file of a run folder: `name`, or the file of version 0.1 if only that exists."""
    old = folder / PROVENANCE
    return old if old.is_file() and not (folder / name).is_file() else folder / name


def current_settings(values: dict[str, Any], source: str) -> dict[str, Any]:
    """Return training settings with their current names.

    Args:
        values: Settings, some or all, with names of version 0.1 or current names.
        source: Where the settings come from, for error messages.

    Raises:
        ValueError: If a setting is given under both of its names.
    """
    out: dict[str, Any] = {}
    hybrid: dict[str, Any] = {}
    for name, value in values.items():
        if name in _HYBRID:
            hybrid[_HYBRID[name]] = _mode(value) if name == "steers" else value
        elif name in _NAMES and isinstance(value, dict):
            out[name] = _renamed(value, _NAMES[name], source)
        else:
            out[name] = value
    if hybrid:
        given = out.get("hybrid", {})
        if isinstance(given, dict):
            if both := [name for name in hybrid if name in given]:
                raise ValueError(f"{source} sets hybrid.{both[0]} twice: by this name and by its name of version 0.1")
            out["hybrid"] = {**hybrid, **given}
    return _renamed(out, _NAMES[""], source)


def current_card(card: Any) -> Any:
    """Return the card of a policy file in the current format, with the current names of its training settings.

    Raises:
        ValueError: If a card of version 0.1 has no valid entry ``view``.
    """
    if not isinstance(card, dict):
        return card
    if isinstance(settings := card.get("settings"), dict):
        card = {**card, "settings": current_settings(settings, "the card")}
    if card.get("format") != POLICY_FORMAT:
        return card
    view = card.get("view")
    # the first cards of version 0.1 have no caution
    if not isinstance(view, dict) or {"caution": 0.0, **view}.keys() != set(_VIEW):
        raise ValueError(f"the view of a card of version 0.1 must have {', '.join(_VIEW)}, not {view!r}")
    out: dict[str, Any] = {}
    for name, value in card.items():
        if name == "format":
            out[name] = "quadpend policy 2"
        elif name == "view":
            out |= {
                "hybrid": _hybrid(view),
                "action_repeat": view["hold"],
                "history": view["history"],
                "history_actions": view["history_actions"],
            }
        else:
            out["provenance" if name == "origin" else name] = value
    return out


def _hybrid(view: dict[str, Any]) -> dict[str, Any] | None:
    """Return the data of the hybrid in a card of version 0.1, or None if its policy acts without base controller."""
    if not view["companion"]:
        return None
    data = {"kind": _mode(view["steers"]), "base_controller": view["companion"]}
    if view["steers"] == "alone":
        return data
    return {**data, "action_scale": view["authority"], "fallback_gain": view.get("caution", 0.0)}


def _mode(steers: Any) -> Any:
    return _MODES.get(steers, steers) if isinstance(steers, str) else steers


def _renamed(values: dict[str, Any], names: dict[str, str], source: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in values.items():
        current = names.get(name, name)
        if current in out:
            raise ValueError(f"{source} sets {current} twice: by this name and by its name of version 0.1")
        out[current] = value
    return out
