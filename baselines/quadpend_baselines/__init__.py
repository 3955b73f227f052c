"""Classical controllers for the QuadPendulum environments, with the `predict` protocol of Stable-Baselines3."""

from quadpend_baselines.policy.protocol import Policy
from quadpend_baselines.registry import CONTROLLERS, controller

__all__ = ["CONTROLLERS", "Policy", "controller"]
