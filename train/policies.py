"""Policies by name, as the command line gives them."""

import hashlib
import zipfile
from pathlib import Path
from typing import Any

from baselines import CONTROLLERS, Policy, ThroughRotors, controller
from baselines.gains import GAINS
from quadpend_gym.actuators import Rotors
from quadpend_gym.observation import OBSERVATION_SIZE
from train.scenarios import Scenario
from train.velocities import WithVelocities


def load_policies(names: str) -> list[Policy]:
    """The policies under one name: one, or several separated by commas, the training seeds of one learner."""
    return [load_policy(name) for name in names.split(",")]


def load_policy(name: str) -> Policy:
    """The policy that `name` stands for.

    Args:
        name: of a classical controller, a key of `baselines.CONTROLLERS`, or the path of a run folder or of a PPO model
            saved by Stable-Baselines3. Loading such a file executes code in it: load only your own.

    Raises:
        ValueError: it is none of these.
    """
    if name in CONTROLLERS:
        return controller(name)
    path = _model_file(name)
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)  # more are slower for small networks, and may round differently
    try:
        return PPO.load(path, device="cpu")
    except (TypeError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no PPO model saved by Stable-Baselines3: {error}") from error


def identities(names: str) -> list[str]:
    """What tells the policies under one name, as in `load_policies`, from all others: see `identity`."""
    return [identity(name) for name in names.split(",")]


def identity(name: str) -> str:
    """What tells a policy from all others: a controller's name and gains, the hash of a model's file.

    Raises:
        ValueError: there is no such policy.
    """
    if name in CONTROLLERS:
        return f"{name} {GAINS[name]!r}"
    return hashlib.sha256(_model_file(name).read_bytes()).hexdigest()


def _model_file(name: str) -> Path:
    path = Path(name)
    if path.is_dir():
        path = path / "model.zip"
    if not path.is_file():
        known = ", ".join(CONTROLLERS)
        raise ValueError(f"there is no policy {name!r}: it is neither {known} nor a run or model file")
    return path


def seated(policy: Policy, scenario: Scenario) -> Policy:
    """The policy as it flies in a scenario.

    A classical controller is told the nominal simulation, and flies rotors, where there are any, through their mixing.
    A learned one that wants to see velocities takes differences where they are hidden.
    """
    adaptable: Any = policy
    if hasattr(policy, "told"):
        told: Policy = adaptable.told(scenario.simulation)
        for model in scenario.actuators:
            if isinstance(model, Rotors):
                return ThroughRotors(told, model, scenario.simulation)
        return told
    if scenario.output_feedback and scenario.history == 1 and not scenario.history_actions:
        space = getattr(policy, "observation_space", None)
        if space is not None and space.shape == (OBSERVATION_SIZE,):
            return WithVelocities(policy, scenario.simulation.period)
    return policy
