"""Classical controllers for the QuadPendulum environments, with the `predict` protocol of Stable-Baselines3."""

from baselines.adrc import ADRC
from baselines.controllers import CONTROLLERS, controller
from baselines.gains import ADRC_GAINS, AdrcGains, ObserverGains
from baselines.policy import Policy
from baselines.rotors import ThroughRotors

__all__ = [
    "ADRC",
    "ADRC_GAINS",
    "CONTROLLERS",
    "AdrcGains",
    "ObserverGains",
    "Policy",
    "ThroughRotors",
    "controller",
]
