"""The simulation of tumbling rigid vehicles agrees with MuJoCo, an independent rigid-body engine."""

import mujoco
import numpy as np
import pytest

from tests.helpers.rigid import random_vehicle
from tests.helpers.rigid_mujoco import rigid_position_errors

DURATION, PERIOD = 2.0, 0.1  # s


def largest_difference(seed: int, with_rotors: bool, step: float) -> float:
    """Return the largest difference of a position in a tumbling flight with random inputs, m.

    `step` is the step of both integrators, s.
    """
    vehicle = random_vehicle(seed, with_rotors)
    (error,) = rigid_position_errors(vehicle, seed, DURATION, PERIOD, [round(PERIOD / step)], step).errors.values()
    return error


@pytest.mark.skipif(
    int(mujoco.__version__.split(".")[0]) < 4,
    reason="before MuJoCo 4.0 its attitude of tumbling bodies is of second order",
)
@pytest.mark.parametrize("with_rotors", [False, True], ids=["wrench", "rotors"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tumbling_rigid_vehicles_agree_with_mujoco(seed: int, with_rotors: bool) -> None:
    assert largest_difference(seed, with_rotors, 5e-4) <= 1e-6


if __name__ == "__main__":  # python -m tests.quadpend_gym.physics.test_rigid_mujoco
    for kind in (False, True):
        differences = [largest_difference(seed, kind, 2e-4) for seed in range(100)]
        name = "rotors" if kind else "wrench"
        print(
            f"{name}: 100 vehicles, largest difference {max(differences):.2g} m, median {np.median(differences):.2g} m"
        )
