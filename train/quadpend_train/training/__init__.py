"""Training with Stable-Baselines3: settings, callbacks, runs."""
