"""The simulation of a tumbling quadrotor agrees with MuJoCo, an independent rigid-body engine."""

import pytest

from quadpend_gym.vehicles import CONTROL_PERIOD, Simulation
from tests.helpers.mujoco_engine import position_errors
from tests.helpers.physics import UNEQUAL


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tumbling_motion_agrees_with_mujoco(seed: int) -> None:
    (error,) = position_errors(UNEQUAL, seed, 2.0, CONTROL_PERIOD, [Simulation().substeps]).errors.values()
    assert error <= 1e-5
