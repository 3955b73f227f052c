"""The environments: the batch simulation and its two adapters, Env and VectorEnv."""
