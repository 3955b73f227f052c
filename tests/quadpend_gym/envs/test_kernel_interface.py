"""The interface between Python and the step kernel: settings, error codes, and the layout of outcome and memory."""

import numpy as np
import pytest

from quadpend_gym import Limits, RewardWeights, Simulation, Task
from quadpend_gym.envs import kernel_layout, outcome
from quadpend_gym.envs.kernel_layout import make_settings, pack_settings, unpack_settings
from quadpend_gym.envs.step_errors import (
    NO_ERROR,
    action_error,
    check_inputs,
    decode_error,
    raise_step_error,
    wind_error,
)

TASK = Task(limits=Limits(1.1, 1.2, 1.3, -0.1), reward=RewardWeights(0.1, 0.2, 0.3, 0.8, 0.9))


@pytest.mark.parametrize(("moves_air", "substeps"), [(True, 3), (False, 0)])
def test_settings_are_the_same_after_packing_and_unpacking(moves_air: bool, substeps: int) -> None:
    settings = make_settings(TASK, Simulation(period=0.02), moves_air, substeps)
    assert unpack_settings(pack_settings(settings)) == settings
    assert settings.weights.effort == pytest.approx(0.8 / 1.4, rel=1e-15)
    assert settings.limits.cos_pendulum_angle == pytest.approx(np.cos(1.1), rel=1e-15)


@pytest.mark.parametrize("row", [0, 1, 4095])
def test_an_error_code_names_its_cause_and_its_row(row: int) -> None:
    assert decode_error(action_error(row)) == ("action", row)
    assert decode_error(wind_error(row)) == ("wind", row)
    assert NO_ERROR not in (action_error(row), wind_error(row))


def test_inputs_are_checked_actions_first() -> None:
    action, wind = np.zeros((3, 4), np.float32), np.zeros((12, 3))
    assert check_inputs(action, wind) == NO_ERROR
    raise_step_error(NO_ERROR, action, wind.T, "action")
    wind[11, 2] = np.inf
    assert check_inputs(action, wind) == wind_error(2)
    with pytest.raises(ValueError, match=r"wind must be finite numbers, not \[0.0, .* inf\] in sub-environment 2"):
        raise_step_error(wind_error(2), action, wind.T, "action")
    action[1, 3] = -1.5
    assert check_inputs(action, wind) == action_error(1)
    with pytest.raises(ValueError, match=r"command of sub-environment 1 must be four numbers .* not \[.* -1.5\]"):
        raise_step_error(action_error(1), action, wind.T, "command")


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


def test_the_weights_of_the_reward_never_sum_to_more_than_one() -> None:
    for values in (
        (0.6, 0.15, 0.1, 0.15),
        (0.56, 0.48, 0.9, 0.09),
        *np.random.default_rng(0).random((500, 4)).tolist(),
    ):
        task = Task(reward=RewardWeights(*values))
        weights = make_settings(task, Simulation(), moves_air=False, substeps=1).weights
        assert 1.0 - 1e-15 <= weights.tracking + weights.upright + weights.yaw + weights.effort <= 1.0
        np.testing.assert_allclose(weights[:4], np.array(values) / sum(values), rtol=1e-14)
