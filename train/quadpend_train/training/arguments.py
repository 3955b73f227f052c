"""Keyword arguments of the algorithms of Stable-Baselines3 and sb3-contrib, as data.

The table of a settings file that has the name of the algorithm is passed to the algorithm's class. Only its names are
checked, against the signature of the class. As data,

- ``{initial = 2e-3, final = 4e-5}`` is a schedule that is linear over the training;
- the ``activation_fn`` in ``policy_kwargs`` is the name of a function, such as ``"relu"``.
"""

import inspect
from collections.abc import Mapping
from typing import Any

from quadpend_gym.core.settings import suggest

# Arguments with other defaults than those of the classes: for many sub-environments and short trainings
_NETWORK = {"net_arch": (64, 64), "activation_fn": "relu"}
_REPLAY = {
    "learning_rate": {"initial": 1e-3, "final": 1e-4},
    "gradient_steps": 4,
    "buffer_size": 300_000,
    "learning_starts": 10_000,
    "ent_coef": "auto_0.1",
    "policy_kwargs": _NETWORK,
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {
        "learning_rate": {"initial": 2e-3, "final": 4e-5},
        "n_steps": 64,
        "batch_size": 1024,
        "n_epochs": 3,
        "gamma": 0.995,
        "policy_kwargs": _NETWORK,
    },
    "sac": _REPLAY,
    "tqc": _REPLAY,
}
# Arguments that a run sets itself
_SET = {"policy", "env", "seed", "device", "tensorboard_log", "_init_setup_model", "self"}
_SET |= {"observation_space", "action_space", "lr_schedule", "features_extractor_class", "features_extractor_kwargs"}


def complete(algo: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments of an algorithm, as data, together with those of `DEFAULTS`, after a check of their names."""
    from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, algorithm_class

    arguments = {**DEFAULTS.get(algo, {}), **given}
    networks = {**DEFAULTS.get(algo, {}).get("policy_kwargs", {}), **given.get("policy_kwargs", {})}
    kind = algorithm_class(algo)
    if "MlpPolicy" not in kind.policy_aliases:
        raise ValueError(f"algo {algo!r} has no policy with a feedforward network")
    _check_names(arguments, kind, algo)
    _check_names(networks, kind.policy_aliases["MlpPolicy"], f"{algo}.policy_kwargs")
    function = networks.get("activation_fn", "relu")
    if function not in ACTIVATION_MODULES:
        known = ", ".join(ACTIVATION_MODULES)
        raise ValueError(f"{algo}.policy_kwargs.activation_fn must be one of {known}, not {function!r}")
    return {**arguments, "policy_kwargs": networks} if networks else arguments


def _check_names(given: Mapping[str, Any], kind: Any, table: str) -> None:
    known = [name for name in inspect.signature(kind).parameters if name not in _SET]
    for name in given:
        if name not in known:
            raise ValueError(
                f"{table} has no argument {name!r}{suggest(name, known)}; its arguments are {', '.join(known)}"
            )


def default(algo: str, name: str) -> Any:
    """Return the default of an argument in the signature of the class; None if it has no such argument."""
    from quadpend_train.policies.sb3_models import algorithm_class

    found = inspect.signature(algorithm_class(algo)).parameters.get(name)
    return None if found is None else found.default


def as_python(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments as the class takes them: schedules as functions, and activation functions as classes."""
    from quadpend_train.policies.sb3_models import ACTIVATION_MODULES

    made = {
        name: linear_schedule(**value) if isinstance(value, Mapping) and value.keys() == {"initial", "final"} else value
        for name, value in arguments.items()
    }
    if "policy_kwargs" in arguments:
        networks = {name: _lists(value) for name, value in arguments["policy_kwargs"].items()}
        if "activation_fn" in networks:
            networks["activation_fn"] = ACTIVATION_MODULES[networks["activation_fn"]]
        made["policy_kwargs"] = networks
    return made


def linear_schedule(initial: float, final: float) -> Any:
    """Return the function from the remaining share of the training to a value that changes linearly."""
    return lambda progress_remaining: final + (initial - final) * max(progress_remaining, 0.0)


def _lists(value: Any) -> Any:
    """Return widths as lists, as Stable-Baselines3 takes them."""
    if isinstance(value, Mapping):
        return {name: _lists(item) for name, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
