"""Training with Stable-Baselines3, and the comparison of learned policies with classical controllers."""
