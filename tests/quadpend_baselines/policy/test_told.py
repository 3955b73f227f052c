"""Policies are designed for the pole that an episode tells."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.policy.told import RATIO, scaled_pole
from quadpend_gym.scenarios import as_scenario
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK
from quadpend_train.evaluation.episodes import run_episodes
from tests.helpers.bad_input import assert_refused

FIELDS = [*OUTPUT_FEEDBACK, "pole"]
POLES = {"share": 0.5, "names": ["rod_length", "bob_mass"]}


def test_each_row_flies_the_design_for_the_length_of_its_pole() -> None:
    scenario = as_scenario("flight_breeze", parameters=POLES, pole_told=True, observation=FIELDS)
    told, env = controller("dual-mode").adapt(scenario), scenario.make_vec(6)
    observation, length = env.reset(seed=0)[0], scenario.vehicle.pole.length
    for row, action in zip(observation, told.predict(observation)[0], strict=True):
        number = np.rint(np.log(scenario.observation.read(row, "pole")[0] / length) / np.log(RATIO))
        vehicle = replace(scenario.vehicle, pole=scaled_pole(scenario.vehicle.pole, RATIO**number))
        own = controller("dual-mode").adapt(replace(scenario, vehicle=vehicle, pole_told=False))
        assert_array_equal(own.predict(row)[0], action)
        assert_array_equal(told.predict(row)[0], action)


def test_a_pole_that_is_told_is_flown_and_one_that_is_not_falls() -> None:
    survived = []
    for is_told in (False, True):
        poles = {**POLES, "share": 0.75}
        scenario = as_scenario("flight_breeze", parameters=poles, pole_told=is_told, observation=FIELDS, duration=5.0)
        survived.append(run_episodes([controller("flatness")], scenario, 30, seed=7).survived.mean())
    assert survived[0] < 0.95
    assert survived[1] == 1.0


def test_a_pole_that_is_not_observed_cannot_be_told() -> None:
    scenario = as_scenario("flight_breeze", pole_told=True, observation="output_feedback")
    assert_refused(lambda: controller("lqg").adapt(scenario), 'needs an observation with "pole"', ValueError)
