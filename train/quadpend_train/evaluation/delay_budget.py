"""The delay that a policy tolerates, found by flying: a delay margin for any policy, learned ones too."""

from dataclasses import replace

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes


def delay_budget(
    policy: Policy,
    scenario: Scenario,
    episodes: int = 100,
    seed: int = TEST_SEED,
    survival: float = 0.99,
    longest: float = 0.1,
) -> float:
    """Return the smallest additional latency, s, at which a policy survives less than a share of its episodes.

    The policy is designed for the scenario and does not know the additional latency, which is a whole number of
    substeps. The latency is first doubled and then bisected, as if survival never grew with it. The result is 0 if the
    share is not reached without an additional latency, and infinite if it is with `longest` (s).
    """
    substep = scenario.period / scenario.substeps

    def survives(substeps: int) -> bool:
        late = replace(scenario, latency=scenario.latency + substeps * substep)
        return bool(run_episodes([policy], late, episodes, seed, known=scenario).survived.mean() >= survival)

    if not survives(0):
        return 0.0
    tolerated, last = 0, round(longest / substep)
    late = min(1, last)
    while survives(late):
        if late == last:
            return np.inf
        tolerated, late = late, min(2 * late, last)
    while late - tolerated > 1:
        middle = (tolerated + late) // 2
        tolerated, late = (middle, late) if survives(middle) else (tolerated, middle)
    return late * substep
