"""The protocol of every policy, and the rollout."""
