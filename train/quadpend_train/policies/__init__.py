"""Learned policies: their file format, their export from Stable-Baselines3, and loading by name."""
