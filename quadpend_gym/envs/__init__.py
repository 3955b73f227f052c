"""The environments: the batched simulation and its two adapters, `gymnasium.Env` and `gymnasium.vector.VectorEnv`."""
