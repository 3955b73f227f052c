"""Scenarios with trajectories of one's own: files, hashes, feasibility, and a controller that tracks them."""

import json

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import controller
from quadpend_gym import Sinusoids, Task, Waypoints
from quadpend_gym.scenarios import Scenario, find_scenario, name_or_json, scenario_hash
from tests.helpers.sources import ROOT

EXAMPLES = {"square": Waypoints, "lissajous": Sinusoids, "ellipse": Sinusoids}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_are_feasible_and_survive_json(name: str, recwarn: pytest.WarningsRecorder) -> None:
    file = str(ROOT / f"docs/scenarios/{name}.toml")
    scenario = find_scenario(file)
    assert isinstance(scenario.task.trajectory, EXAMPLES[name])
    assert find_scenario(name_or_json(file)) == scenario
    assert not recwarn


def test_flatness_tracks_the_square_to_one_millimetre_in_calm_air() -> None:
    env = find_scenario(str(ROOT / "docs/scenarios/square.toml")).make_vec(2, AutoresetMode.SAME_STEP)
    policy, memory, started, errors = controller("flatness"), None, np.ones(2, np.bool_), []
    observation, _ = env.reset(seed=0)
    for _ in range(1000):
        action, memory = policy.predict(observation, memory, started)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated.any()
        started[:] = False
        errors.append(np.linalg.norm(info["tracking_error"], axis=-1))
    assert np.max(errors[500:]) < 1e-3


def test_a_scenario_without_a_trajectory_keeps_its_hash() -> None:
    plain = Scenario(task=Task())
    assert scenario_hash(plain) == "862c43ea3c51"
    assert "trajectory" not in json.loads(name_or_json('{"task": {}}'))["task"]
    moving = Scenario(task={"trajectory": {"offset": [0, 0, 2, 0]}})
    assert scenario_hash(moving) != scenario_hash(plain)


def test_a_scenario_that_cannot_be_flown_is_refused() -> None:
    drop = {"kind": "waypoints", "times": [0, 0.5], "points": [[0, 0, 4], [0, 0, 1]]}
    with pytest.raises(ValueError, match=r"the trajectory cannot be flown: it needs a pendulum tilt of 180.0°"):
        find_scenario(json.dumps({"task": {"trajectory": drop}}))
