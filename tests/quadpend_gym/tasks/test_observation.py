"""The observation is a list of fields by name."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_gym import read_observation
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, OUTPUT_FEEDBACK
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import make, make_vec

NAMES = ["yaw_reference", "attitude", "tracking_error"]


def test_environments_observe_the_fields_that_are_listed_in_that_order() -> None:
    whole, actions = make_vec(3, wind="windy"), np.full((3, 4), 0.01, np.float32)
    listed = make(wind="windy", observation=NAMES), make_vec(3, wind="windy", observation=NAMES)
    learned = SB3VecEnv(make_vec(3, wind="windy", observation=NAMES, autoreset_mode="SameStep"))
    learned.seed(0)
    single, many, of_sb3 = listed[0].reset(seed=0)[0], listed[1].reset(seed=0)[0], learned.reset()
    full = whole.reset(seed=0)[0]
    for _ in range(2):
        for name in NAMES:
            wanted = read_observation(full, name)
            assert_array_equal(read_observation(many, name, NAMES), wanted)
            assert_array_equal(read_observation(of_sb3, name, NAMES), wanted)
            assert_array_equal(read_observation(single, name, NAMES), wanted[0])
        single, many, full = listed[0].step(actions[0])[0], listed[1].step(actions)[0], whole.step(actions)[0]
        of_sb3 = learned.step(actions)[0]
        assert listed[0].observation_space.contains(single)
        assert listed[1].observation_space.contains(many)
        assert learned.observation_space.contains(of_sb3[0])


def test_a_layout_selects_the_fields_of_another_one() -> None:
    observation = np.arange(36.0)
    assert FULL.select(FULL) == slice(0, 36)
    assert_array_equal(OUTPUT_FEEDBACK.scale, FULL.scale[FULL.select(OUTPUT_FEEDBACK)])
    found = observation[FULL.select(["attitude", "direction"])]
    assert_array_equal(found, [12, 13, 14, 6, 7, 8])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("fll", "no preset of the observation 'fll' .did you mean 'full'.*or give a list of fields"),
        (["atitude"], "no field of the observation 'atitude' .did you mean 'attitude'"),
        (["attitude", "attitude"], "each field once"),
        ([], "a list of fields, not"),
    ],
    ids=str,
)
def test_wrong_observations_are_refused(given: object, message: str) -> None:
    assert_refused(lambda: Scenario(observation=given), message, ValueError)  # type: ignore[arg-type]


def test_a_field_is_not_read_from_another_layout() -> None:
    assert_refused(lambda: read_observation(np.zeros(27), "attitude"), "has 36 numbers, not 27", ValueError)
    unknown = lambda: read_observation(np.zeros(27), "euler_rate", "output_feedback")  # noqa: E731
    assert_refused(unknown, "no field of the observation 'euler_rate'", ValueError)
