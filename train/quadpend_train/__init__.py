"""Training with Stable-Baselines3, and the comparison of learned and classical policies."""
