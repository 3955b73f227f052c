"""The plans of a recovery are for the vehicle that flies."""

import numpy as np

from experiments.recovery import BASE, LATE, fly, planar_step, quiet
from quadpend_gym.scenarios import SCENARIOS


def test_a_step_in_the_plane_is_a_step_of_the_environment() -> None:
    scenario = quiet(SCENARIOS[BASE])
    assert round(scenario.latency / scenario.period) == LATE
    step, low, high = planar_step(scenario), *scenario.vehicle.rotors.thrust  # type: ignore[union-attr]
    actions = np.random.default_rng(0).uniform(-0.02, 0.02, (2, 30))
    states, flown, _ = fly(scenario, 0.3, actions)
    for k in range(30):
        after, commanded = step(states[:, LATE + k], flown[:, k])
        np.testing.assert_allclose(after.full().ravel(), states[:, LATE + k + 1], rtol=1e-9, atol=1e-9)
        assert low < commanded.full().min() <= commanded.full().max() < high
