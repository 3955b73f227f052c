"""Flat outputs: the kernel follows the trajectory open loop, and statics and thrust direction agree with the model."""

import numpy as np
import pytest

from quadpend_gym import PAPER, Parameters, Reference
from quadpend_gym.core.arrays import Floats
from tests.helpers.controllers import CALM, disturbance_of, flat_state_and_command
from tests.helpers.physics import UNEQUAL, simulate_period

TIME = 0.3
ON_QUADROTOR = disturbance_of(force=(0.3, -0.2, 0.15), torque=(0.1, -0.05, 0.03))
ON_BOTH = ON_QUADROTOR + disturbance_of(bob_force=(0.05, -0.04, 0.1))
# A climbing circle with an acceleration of 1.4 m/s² and a drifting, oscillating yaw.
CIRCLE = Reference(
    offset=(0.3, 0.1, 2.0, 0.8),
    rate=(0.1, 0.0, 0.3, 0.5),
    amplitude=(1.0, 1.0, 0.0, 0.4),
    frequency=(1.2, 1.2, 0.0, 1.0),
    phase=(np.pi / 2, 0.0, 0.0, 0.3),
)
VERTICAL_OSCILLATION = Reference(amplitude=(0.0, 0.0, 0.4, 0.5), frequency=(0.0, 0.0, 1.5, 1.0))


def figure_eight(acceleration: float) -> Reference:
    """Return a figure eight of 2 m length with a peak acceleration a in m/s²: ω² = 8 a/(17 radius)."""
    return Reference.figure_eight(1.0, np.sqrt(8.0 * acceleration / 17.0))


def open_loop(reference: Reference, disturbance: Floats, p: Parameters, period: float = 2e-3) -> float:
    """Return the largest deviation of the kernel from the flat state, in any component, under the flat command."""
    state, _ = flat_state_and_command(reference, 0.0, disturbance, p)
    deviation = 0.0
    for step in range(round(TIME / period)):
        _, command = flat_state_and_command(
            reference, (step + 0.5) * period, disturbance, p
        )  # that of the middle of the period
        state = simulate_period(state, command, disturbance, p, period, 1)
        expected, _ = flat_state_and_command(reference, (step + 1) * period, disturbance, p)
        deviation = max(deviation, float(np.abs(state - expected).max()))
    return deviation


@pytest.mark.parametrize("reference", [CIRCLE, VERTICAL_OSCILLATION], ids=["circle", "vertical oscillation"])
def test_open_loop_command_follows_the_reference_in_wind(reference: Reference) -> None:
    """The unstable pole amplifies errors by 8 in 0.3 s; the remaining error comes from the sampling of the command."""
    assert open_loop(reference, ON_QUADROTOR, UNEQUAL) < 5e-7


def test_open_loop_error_on_a_figure_eight_is_that_of_the_neglected_bob_acceleration() -> None:
    """(1) neglects s l r̈_z, which is proportional to tilt³ ω², that is to a⁴ for figure eights of the same size."""
    fast, slow = open_loop(figure_eight(1.0), CALM, PAPER), open_loop(figure_eight(0.5), CALM, PAPER)
    assert fast < 1e-4
    assert fast / slow > 14.0
    assert open_loop(figure_eight(1.0), ON_BOTH, PAPER) < 2e-4
