"""Tasks: reference trajectories, random starts, termination limits, rewards and the observation."""
