"""The `predict` protocol that all policies share, the rollout, and rotor allocation."""
