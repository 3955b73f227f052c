"""The `predict` protocol that all policies share, and the rollout of a policy."""
