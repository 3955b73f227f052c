"""Wind in environments: independent of how it is attached, reproducible, and consistent with `info`."""

import copy
import json
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import PAPER, Constant, Limits, OrnsteinUhlenbeck, Sinusoid, StillAir, Task
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import Streams
from quadpend_gym.physics.dynamics import momentum
from quadpend_gym.physics.kernel import advance
from quadpend_gym.wind import KINDS, PRESETS, Sum, Wind, as_wind
from quadpend_gym.wrappers import VectorWindWrapper, WindWrapper
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import (
    ENDLESS,
    WINDY,
    assert_same,
    draw_actions,
    make,
    make_unwrapped,
    make_vec,
    run_actions,
    select_info,
)
from tests.helpers.wind import EXAMPLES, PERIOD, every_kind, sample_wind

# All winds for which environments are compared.
EVERYTHING = {**EXAMPLES, "windy sum": WINDY, **{name: name for name in PRESETS}}
every_wind = pytest.mark.parametrize("wind", EVERYTHING.values(), ids=EVERYTHING.keys())


def test_every_kind_has_an_example_that_is_non_zero_after_a_few_steps() -> None:
    assert {**{name: type(model) for name, model in EXAMPLES.items()}, "still_air": StillAir} == KINDS
    for model in EXAMPLES.values():
        assert (sample_wind(model, 10, 3) != 0.0).any(axis=(0, 2)).all()


def test_winds_are_added_from_either_side_and_by_sum() -> None:
    one, other = OrnsteinUhlenbeck(force=0.5), Sinusoid(force=1.0)
    assert "breeze" + one == Sum(("breeze", one))
    assert sum([one, other, other]) == one + other + other
    assert {"kind": "constant", "force": 0.1} + one == Sum((Constant(force=0.1), one))


def test_a_sum_is_the_sum_of_its_models() -> None:
    one, other = OrnsteinUhlenbeck(force=0.5), Constant(force=1.0, torque=0.1)
    assert_allclose(sample_wind(one + other, 50, 4), sample_wind(one, 50, 4) + sample_wind(other, 50, 4), rtol=1e-15)
    assert_same(sample_wind(one + other, 50, 4), sample_wind(Sum((one, other)), 50, 4))
    assert_same(sample_wind(one + (other + other), 50, 4), sample_wind(one + other + other, 50, 4))


@every_kind
def test_models_presets_and_mappings_can_be_added(wind: Any) -> None:
    assert as_wind(wind + "windy") == (*as_wind(wind), *as_wind("windy"))
    assert as_wind(wind + {"kind": "constant", "force": 1.0}) == (*as_wind(wind), Constant(force=1.0))
    assert as_wind(["windy", wind, None]) == (*as_wind("windy"), *as_wind(wind))


@every_kind
def test_adding_a_model_does_not_change_the_others(wind: Any) -> None:
    added = OrnsteinUhlenbeck(force=0.0, torque=(0.1, 0.0, 0.0))
    both, alone = sample_wind(wind + added, 50, 4), sample_wind(wind, 50, 4)
    assert (both != alone)[..., 6].all()
    assert_array_equal(np.delete(both, 6, axis=-1), np.delete(alone, 6, axis=-1))


def test_equal_models_in_a_sum_are_independent() -> None:
    wind = OrnsteinUhlenbeck(force=0.5)
    assert_allclose(sample_wind(wind + wind, 1, 5000).std(axis=1)[0, :3], 0.5 * np.sqrt(2.0), rtol=0.04)


def test_every_sub_environment_and_every_episode_has_its_own_wind() -> None:
    env = make_vec(3, wind=WINDY)
    winds = []
    for seed in (0, None, None):
        env.reset(seed=seed)
        winds += list(env.step(np.zeros((3, 4)))[4]["disturbance"][:, 0])
    assert len(set(winds)) == 9


@every_wind
def test_keyword_and_wrapper_give_the_same_wind_in_single_and_vector_environments(wind: Any) -> None:
    # Long enough for the first gusts of every preset.
    actions = 0.1 * draw_actions(0, 230 if isinstance(wind, str) else 20)
    calm = {"task": ENDLESS}
    results = [
        [env.reset(seed=3)[0], *(step[:2] for step in run_actions(env, actions))]
        for env in (make(wind=wind, **calm), WindWrapper(make(**calm), wind))
    ]
    for rows in (make_vec(4, wind=wind, **calm), VectorWindWrapper(make_vec(4, **calm), wind)):
        first = rows.reset(seed=0)[0][3]
        result = run_actions(rows, np.repeat(actions[:, np.newaxis], 4, axis=1))
        results.append([first, *((step[0][3], step[1][3]) for step in result)])
    for result in results[1:]:
        assert_same(result, results[0])


def test_a_wrapper_adds_its_wind_to_the_existing_one() -> None:
    wrapped, summed = WindWrapper(make(wind=Constant(force=1.0)), WINDY), make(wind=Constant(force=1.0) + WINDY)
    wrapped.reset(seed=0), summed.reset(seed=0)
    actions = draw_actions(0, 10)
    assert_same(run_actions(wrapped, actions), run_actions(summed, actions))


def test_an_unknown_preset_is_refused_with_the_known_names() -> None:
    for attach in (lambda: make_vec(2, wind=["windy", "gale"]), lambda: WindWrapper(make(), "gale")):
        assert_refused(attach, f"there is no wind 'gale'; there are {', '.join(PRESETS)}", ValueError)


def wind_by_episode(env: Any, row: int, actions: Any, episodes: int) -> list[list[bytes]]:
    """Return the wind in each step of the first episodes of a row of a vector environment with same-step autoreset."""
    winds: list[list[bytes]] = [[] for _ in range(episodes + 1)]
    for action in actions:
        episode = env.world.episode[row]
        if episode == episodes:
            return winds[:-1]
        winds[episode].append(env.world.wind[row].tobytes())
        env.step(action)
    raise AssertionError("too few actions for these episodes")


@every_kind
def test_the_wind_of_episode_k_does_not_depend_on_policy_number_of_rows_or_episode_lengths(wind: Any) -> None:
    """With other actions, lengths and rows the wind is the same for as long as both episodes last."""
    results = []
    for rows, policy, tilt in ((1, 0, 0.4), (5, 1, 0.6)):
        task = Task(limits=Limits(body_angle=tilt))
        env = make_vec(rows, wind=wind, task=task, max_episode_steps=20, autoreset_mode="SameStep")
        env.reset(seed=10 - (rows - 1))
        results.append(wind_by_episode(env, rows - 1, draw_actions(policy, 200, rows), 4))
    for one, other in zip(*results, strict=True):
        assert all(a == b for a, b in zip(one, other, strict=False))
    # The lengths do differ, and different episodes have different winds …
    assert any(len(one) != len(other) for one, other in zip(*results, strict=True))
    if not isinstance(wind, Constant):  # … unless the wind is constant.
        firsts = [episode[3] for episode in results[0]]
        assert len(set(firsts)) == len(firsts)


@every_kind
def test_wind_and_info_of_single_and_vector_environments_are_equal_to_the_last_bit(wind: Any) -> None:
    rows = make_vec(3, wind=wind, max_episode_steps=9, autoreset_mode="SameStep")
    single = make(wind=wind, max_episode_steps=9)
    rows.reset(seed=5), single.reset(seed=7)
    for action in draw_actions(0, 40):
        assert_same(rows.world.wind[2], single.unwrapped.world.wind[0])
        *_, info = rows.step(np.tile(action, (3, 1)))
        *_, terminated, truncated, expected = single.step(action)
        if terminated or truncated:
            info = info["final_info"]
            single.reset()
        assert_same(select_info(info, 2), expected)


@every_kind
@pytest.mark.parametrize("rows", [None, 3], ids=["single", "vector"])
def test_a_copy_made_during_an_episode_has_the_same_wind(wind: Any, rows: int | None) -> None:
    env: Any = make_vec(3, wind=wind, max_episode_steps=15) if rows else make(wind=wind)
    shape = (10, rows) if rows else (10,)
    env.reset(seed=5)
    run_actions(env, draw_actions(0, *shape))
    copied = copy.deepcopy(env)
    assert_same(run_actions(copied, draw_actions(1, *shape)), run_actions(env, draw_actions(1, *shape)))


@every_wind
def test_wind_does_not_change_initial_states_and_references(wind: Any) -> None:
    calm, windy = make_vec(5), make_vec(5, wind=wind)
    for seed in (0, None, None):
        (observation, info), (expected, expected_info) = windy.reset(seed=seed), calm.reset(seed=seed)
        assert_same((observation, {name: info[name] for name in expected_info}), (expected, expected_info))
        assert_array_equal(windy.world.reference, calm.world.reference)
        run_actions(windy, draw_actions(0, 10, 5)), run_actions(calm, draw_actions(1, 3, 5))


@every_kind
def test_a_model_as_plain_data_survives_json(wind: Any) -> None:
    mapping = json.loads(json.dumps(asdict(wind)))
    assert mapping["kind"] in KINDS
    assert as_wind(mapping) == as_wind(wind)
    assert_same(sample_wind(mapping, 30, 3), sample_wind(wind, 30, 3))


@every_wind
def test_a_spec_with_wind_survives_json(wind: Any) -> None:
    env = make(wind=wind)
    assert env.spec is not None
    copied = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert_same(copied.reset(seed=3), env.reset(seed=3))
    assert_same(run_actions(copied, draw_actions(0, 10)), run_actions(env, draw_actions(0, 10)))


@dataclass(frozen=True)
class Ramp:
    """A custom model: a force in x that grows linearly in time from a random value."""

    slope: float = 1.0
    memory_size: int = 1
    moves_air: bool = False

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the force of the first step."""
        return streams.uniform(np.zeros(streams.keys.size, np.int64), 1)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the force, and increase it."""
        out[:, 0] += memory[:, 0]
        memory[:, 0] += self.slope * period


def test_a_custom_model_works() -> None:
    assert isinstance(Ramp(), Wind)
    env, rows = make_unwrapped(wind=Ramp()), make_vec(3, wind=Sum((Ramp(), Constant(torque=0.1))))
    env.reset(seed=2), rows.reset(seed=0)
    single = [step[4]["disturbance"] for step in run_actions(env, np.zeros((10, 4)))]
    many = [step[4]["disturbance"][2] for step in run_actions(rows, np.zeros((10, 3, 4)))]
    assert_allclose(np.diff([disturbance[0] for disturbance in single]), 0.01, rtol=1e-12)
    assert_array_equal([disturbance[0] for disturbance in many], [disturbance[0] for disturbance in single])


STORMY = WINDY + "storm" + Constant(velocity=(3.0, -4.0, 1.0))


@pytest.mark.parametrize("wind", [WINDY, STORMY], ids=["forces", "forces and moving air"])
def test_the_disturbance_in_info_determines_the_next_state(wind: Any) -> None:
    """The state follows from the previous state, the action and `info["disturbance"]`."""
    env = make_unwrapped(wind=wind)
    env.reset(seed=0)
    parameters = PAPER.as_array()[np.newaxis]
    for action in draw_actions(0, 10):
        state = env.state.array[np.newaxis].copy()
        info = env.step(action)[4]
        command = np.array([[PAPER.hover_thrust, 5.0, 5.0, 1.0]]) * (action + np.eye(4)[0])
        advance(state, command, info["disturbance"][np.newaxis], parameters, PERIOD, 2)
        assert_allclose(env.state.array, state[0], atol=1e-14)


@pytest.mark.parametrize("wind", [WINDY, STORMY], ids=["forces", "forces and moving air"])
def test_the_disturbance_in_info_determines_momentum_and_body_rates(wind: Any) -> None:
    env = make_unwrapped(task=ENDLESS, wind=wind)
    env.reset(seed=0)
    no_thrust = (-1.0, 0.0, 0.0, 0.0)
    for _ in range(10):
        before, spin = momentum(env.state.array, PAPER), env.state.euler_rate.copy()
        disturbance = env.step(no_thrust)[4]["disturbance"]
        force = disturbance[0:3] + disturbance[3:6] - (0.0, 0.0, PAPER.hover_thrust)
        assert_allclose(momentum(env.state.array, PAPER) - before, PERIOD * force, rtol=1e-9)
        assert_allclose(env.state.euler_rate - spin, PERIOD * disturbance[6:9] / PAPER.inertia_roll, rtol=1e-9)


def test_the_air_velocity_in_info_is_that_of_the_wind() -> None:
    env, rows = make_unwrapped(wind=STORMY), make_vec(4, wind=STORMY)
    env.reset(seed=0), rows.reset(seed=0)
    for action in draw_actions(0, 5):
        expected, expected_rows = env.world.wind[0, 9:12].copy(), rows.world.wind[:, 9:12].copy()
        assert_array_equal(env.step(action)[4]["air_velocity"], expected)
        assert_array_equal(rows.step(np.tile(action, (4, 1)))[4]["air_velocity"], expected_rows)
        assert (expected_rows != 0.0).all()


@every_kind
def test_info_has_an_air_velocity_if_the_wind_has_one(wind: Any) -> None:
    velocities = (sample_wind(wind, 10, 3)[..., 9:12] != 0.0).any()
    env, rows = make(wind=wind), make_vec(2, wind=wind)
    for info in (env.reset(seed=0)[1], env.step(np.zeros(4))[4]):
        assert ("air_velocity" in info) == velocities
    for info in (rows.reset(seed=0)[1], rows.step(np.zeros((2, 4)))[4]):
        assert ("air_velocity" in info) == ("_air_velocity" in info) == velocities
    assert "air_velocity" not in make().reset(seed=0)[1]


def test_the_wind_in_info_is_zero_at_a_reset() -> None:
    info = make(wind=STORMY).reset(seed=0)[1]
    assert_array_equal(info["disturbance"], np.zeros(9))
    assert_array_equal(info["air_velocity"], np.zeros(3))


@pytest.mark.parametrize("nothing", [None, "calm", (), Sum(), [None, "calm"]], ids=repr)
def test_all_ways_to_specify_no_wind_are_equal(nothing: Any) -> None:
    actions = draw_actions(0, 5)
    calm, empty = make_unwrapped(task=Task()), make_unwrapped(task=Task(), wind=nothing)
    assert_same(empty.reset(seed=0), calm.reset(seed=0))
    result = run_actions(calm, actions)
    assert_same(run_actions(empty, actions), result)
    assert_array_equal(list(chain.from_iterable(step[4]["disturbance"] for step in result)), 0.0)


def test_a_nan_wind_raises_an_error_and_does_not_end_the_episode() -> None:
    env = make_vec(3, wind=Ramp(slope=np.nan))
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    before = env.world.state.copy()
    with pytest.raises(ValueError, match=r"wind must be finite numbers, not \[nan, 0.0, .*\] in sub-environment 0"):
        env.step(np.zeros((3, 4)))
    assert_array_equal(env.world.state, before)
