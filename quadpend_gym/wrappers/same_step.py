"""The last observations of episodes in a vector environment with same-step autoreset.

With same-step autoreset, `step` returns the first observation of the next episode for each sub-environment whose
episode ended. The last observation of the ended episode is in ``info["final_obs"]``, an object array of shape (n,) that
holds None for the other sub-environments. A wrapper that changes observations must change both.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats32


def last_observations(observation: Floats32, info: dict[str, Any], ended: Booleans) -> Floats32:
    """Return the observations, shape (n, k), that the last step reached, before any same-step autoreset.

    Args:
        observation: The observations that `step` returned, shape (n, k).
        info: The info that `step` returned.
        ended: The sub-environments whose episode ended with the step, shape (n,).
    """
    if "final_obs" not in info:
        return observation
    last = observation.copy()
    last[ended] = np.stack(info["final_obs"][ended])
    return last


def replace_final_observations(info: dict[str, Any], ended: Booleans, last: Floats32) -> None:
    """Set ``info["final_obs"]`` and its mask ``info["_final_obs"]``, to the last observations, shape (n, k)."""
    final = np.empty(ended.size, object)  # filled with None
    for row in np.flatnonzero(ended):
        final[row] = last[row].copy()
    info["final_obs"], info["_final_obs"] = final, ended
