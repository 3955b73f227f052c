"""The observation is a list of fields by name."""

from dataclasses import asdict
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quadpend_gym import Reference, Waypoints, read_observation
from quadpend_gym.physics.state import State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, LAB, OUTPUT_FEEDBACK
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import ENDLESS, make, make_vec

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


def test_a_lab_observes_what_it_measures_the_whole_reference_and_the_pole_that_it_believes() -> None:
    """A flight that turns, with noisy and lost samples, on references of one sinusoid and of waypoints."""
    sensors = [{"kind": "noise", "position": 0.01, "euler": 0.02}, {"kind": "dropout", "probability": 0.4}]
    turning = Reference(offset=(0.1, 0.2, 2.0, 2.5), rate=(0.1, 0.0, 0.0, 2.9))
    moving = Waypoints(times=(0.0, 2.0), points=((0.0, 0.0, 2.0), (1.0, 0.0, 2.0)))
    for reference, sensor in ((turning, ()), (moving, sensors)):
        env = make_vec(
            5, vehicle="hummingbird", interface="body_rates", sensors=sensor, observation="lab", task=ENDLESS
        )
        observation, world = env.reset(seed=0, options={"reference": reference})[0], env.world
        signs, ages = [], []
        for step in range(60):
            read = partial(read_observation, observation, fields="lab")
            true, point = State(world.measured), reference.derivatives(step * 0.01)
            assert_allclose(read("position"), true.position, rtol=0, atol=1e-6)
            attitude = Rotation.from_quat(read("quaternion"), scalar_first=True).as_matrix()
            assert_allclose(attitude, Rotation.from_euler("xyz", true.euler).as_matrix(), rtol=0, atol=1e-6)
            assert_allclose(read("reference_0"), np.tile(point[0, :3], (5, 1)), rtol=0, atol=1e-6)
            assert_allclose(read("reference_1"), np.tile(point[1, :3], (5, 1)), rtol=0, atol=1e-6)
            assert_allclose(read("pole"), [[0.565, 0.05]] * 5, rtol=1e-6)
            signs.append(read("quaternion"))
            ages.append(read("age")[:, 0])
            observation = env.step(np.tile(np.float32([0, 0, 0, 1]), (5, 1)))[0]
        assert (np.sum(np.diff(signs, axis=0) ** 2, axis=-1) < 0.1).all()  # no jump of the sign
        lost = np.diff(ages, axis=0) > 0.0
        assert lost.any() == bool(sensor)
        assert_allclose(np.diff(ages, axis=0)[lost], 0.01, rtol=1e-5)


def test_the_pole_is_told_only_where_the_scenario_says_so() -> None:
    ranges = {"share": 0.2, "names": ["bob_mass", "rod_length"]}
    for told in (False, True):
        env = make_vec(4, vehicle="hummingbird", parameters=ranges, observation=["pole"], pole_told=told)
        observation, info = env.reset(seed=1)
        wanted = info["parameters"][:, [2, 1]] if told else [[0.565, 0.05]] * 4
        assert_allclose(read_observation(observation, "pole", ["pole"]), wanted, rtol=1e-6)


@pytest.mark.parametrize("trajectory", [None, Waypoints(times=(0.0, 2.0), points=((0, 0, 2), (1, 0, 2)))], ids=str)
def test_a_reference_jumps_out_and_back(trajectory: Waypoints | None) -> None:
    """The offset of the reference from the one without jumps; the derivatives stay."""
    jumps = {"distance": [0.2, 0.4], "yaw": [0.5, 0.7], "pause": [0.1, 0.2]}
    task = {**asdict(ENDLESS), "trajectory": trajectory}
    envs = [make_vec(3, task={**task, "jumps": jumps}, observation="lab"), make_vec(3, task=task, observation="lab")]
    observed = []
    for env in envs:
        observed.append([env.reset(seed=2)[0]])
        observed[-1] += [env.step(np.zeros((3, 4), np.float32))[0] for _ in range(99)]
    jumping, still = np.array(observed)
    difference = {name: read_observation(jumping - still, name, "lab") for name in LAB}
    assert not difference["reference_1"].any()
    assert not difference["position"].any()
    offset, yaw = difference["reference_0"], np.abs(difference["yaw_reference"][..., 0])
    distance, out = np.hypot(offset[..., 0], offset[..., 1]), yaw > 0.4
    assert (distance[out] > 0.19).all()
    assert (distance[out] < 0.41).all()
    assert (yaw[out] < 0.71).all()
    assert_allclose(offset[~out], 0.0, atol=1e-6)
    assert not out[:10].any()  # no jump before the first pause
    changes = np.sum(np.diff(out, axis=0), axis=0)
    assert ((changes >= 5) & (changes <= 9)).all()
    single = make(task={**task, "jumps": jumps}, observation="lab")
    single.reset(seed=3)
    for row in jumping[1:, 1]:
        assert_array_equal(single.step(np.zeros(4, np.float32))[0], row)


def test_jumps_of_no_size_are_refused() -> None:
    assert_refused(lambda: make(task={"jumps": {"pause": [1, 2]}}), "a distance or a yaw above zero", ValueError)
