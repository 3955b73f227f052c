"""Policies by name, as the command line gives them."""

from pathlib import Path

from baselines import ADRC, Policy, ThroughRotors
from quadpend_gym.actuators import Rotors
from train.scenarios import Scenario


def load_policies(names: str) -> list[Policy]:
    """The policies under one name: one, or several separated by commas, the training seeds of one learner."""
    return [load_policy(name) for name in names.split(",")]


def load_policy(name: str) -> Policy:
    """The policy that `name` stands for.

    Args:
        name: ``adrc`` followed by the name of its gains (``adrc-paper``, ``adrc-matched``), or the path of a run folder
            or of a PPO model saved by Stable-Baselines3. Loading such a file executes code in it: load only your own.

    Raises:
        ValueError: it is none of these.
    """
    if name.startswith("adrc-"):
        return ADRC(name.removeprefix("adrc-"))
    path = Path(name)
    if path.is_dir():
        path = path / "model.zip"
    if not path.is_file():
        raise ValueError(f"there is no policy {name!r}: it is neither adrc-paper, adrc-matched nor a run or model file")
    from stable_baselines3 import PPO

    return PPO.load(path, device="cpu")


def seated(policy: Policy, scenario: Scenario) -> Policy:
    """The policy as it flies in a scenario.

    A classical controller is told the nominal simulation, and flies rotors, where there are any, through their mixing.
    """
    if not isinstance(policy, ADRC):
        return policy
    told = type(policy)(policy.gains, scenario.simulation)
    for model in scenario.actuators:
        if isinstance(model, Rotors):
            return ThroughRotors(told, model, scenario.simulation)
    return told
