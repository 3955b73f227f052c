"""The root folder of the repository, and libraries that are slow to import."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = {"torch", "stable_baselines3", "matplotlib", "pygame"}
