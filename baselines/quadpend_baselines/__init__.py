"""Classical controllers for the QuadPendulum environments, with the `predict` protocol of Stable-Baselines3."""

from quadpend_baselines.controllers.adrc import ADRC
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains, ObserverGains
from quadpend_baselines.policy.protocol import Policy
from quadpend_baselines.registry import CONTROLLERS, controller

__all__ = [
    "ADRC",
    "ADRC_GAINS",
    "CONTROLLERS",
    "AdrcGains",
    "ObserverGains",
    "Policy",
    "controller",
]
