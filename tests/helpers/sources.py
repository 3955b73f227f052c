"""The root of the repository, and packages that must not be imported at once."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


HEAVY = {"torch", "stable_baselines3", "matplotlib", "pygame"}
