"""The interface between Python and the step kernel: settings, error codes, and the layout of outcome and memory."""

import numpy as np
import pytest

from quadpend_gym import Limits, RewardWeights, Simulation, Task
from quadpend_gym.envs import kernel_layout, outcome
from quadpend_gym.envs.kernel_layout import make_settings, pack_settings, unpack_settings

TASK = Task(limits=Limits(1.1, 1.2, 1.3, -0.1), reward=RewardWeights(0.1, 0.2, 0.3, 0.8, 0.9))


@pytest.mark.parametrize(("moves_air", "substeps"), [(True, 3), (False, 0)])
def test_settings_are_the_same_after_packing_and_unpacking(moves_air: bool, substeps: int) -> None:
    settings = make_settings(TASK, Simulation(period=0.02), moves_air, substeps)
    assert unpack_settings(pack_settings(settings)) == settings
    assert settings.weights.effort == pytest.approx(0.8 / 1.4, rel=1e-15)
    assert settings.limits.cos_pendulum_angle == pytest.approx(np.cos(1.1), rel=1e-15)


def test_the_outcome_layout_has_no_gap_and_no_overlap() -> None:
    names = (
        "TRACKING_TERM UPRIGHT_TERM YAW_TERM EFFORT_TERM TRACKING_ERROR TILT REWARD TERMINATED DISTURBANCE AIR_VELOCITY"
        " PARAMETERS COMMAND"
    )
    rows = np.arange(outcome.OUTCOME_SIZE)
    assert np.concatenate([np.atleast_1d(rows[getattr(outcome, name)]) for name in names.split()]).tolist() == [*rows]


def test_the_memory_layout_has_no_gap_and_no_overlap() -> None:
    columns = np.arange(kernel_layout.MEMORY_SIZE)
    parts = kernel_layout.MEMORY_STATE, kernel_layout.MEMORY_PARAMETERS, kernel_layout.MEMORY_REFERENCE
    assert np.concatenate([columns[part] for part in parts]).tolist() == [*columns]
