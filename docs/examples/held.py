"""A model of Stable-Baselines3 that was trained at 25 Hz, in a loop of 100 Hz: each action is held for four steps.

python -m experiments.flight lqg mine=held:Held --out results/flight
"""

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import episode_start_mask, select_rows
from quadpend_train import load_policy


class Held(Policy):
    def __init__(self):
        self.policy = load_policy("recipe.zip")  # it stacks observations and actions by itself
        self.layouts = self.policy.layouts

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        seen = np.atleast_2d(observation)
        started = episode_start_mask(episode_start, state is None, len(seen))
        action, memory = self.policy.predict(seen, None if state is None else state[2], started)
        step = np.zeros(len(seen), np.int64)
        if state is not None:
            step = np.where(started, 0, state[0])
            action, memory = select_rows(step % 4 == 0, (action, memory), state[1:])
        return (action[0] if np.ndim(observation) == 1 else action), (step + 1, action, memory)
