"""Vector environments for training: the adapter to Stable-Baselines3 and the wrappers of the training loop."""
