"""Vector environments for training: the Stable-Baselines3 adapter and wrappers of the training loop."""
