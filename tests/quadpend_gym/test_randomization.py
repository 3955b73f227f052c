"""Randomized parameters: their distribution, that `info` reports them, and that the physics uses them."""

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from quadpend_gym import PAPER, OrnsteinUhlenbeck, Parameters, Simulation, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.randomization import Around, ParameterRanges, as_ranges
from quadpend_gym.vehicles import PARAMETER_NAMES
from quadpend_gym.wrappers import ParameterWrapper, VectorParameterWrapper
from tests.helpers.bad_input import assert_refused_unchanged
from tests.helpers.envs import (
    AT_REST,
    ENDLESS,
    WINDY,
    assert_same,
    draw_actions,
    make_unwrapped,
    make_vec,
    run_actions,
    select_info,
)
from tests.helpers.physics import UNEQUAL

RANGES = ParameterRanges(
    quadrotor_mass=(0.3, 0.8),
    bob_mass=(0.05, 0.3),
    rod_length=(0.2, 0.6),
    gravity=(9.7, 9.9),
    inertia_roll=(0.05, 0.1),
    inertia_pitch=(0.1, 0.2),
    inertia_yaw=(0.15, 0.16),
    quadrotor_drag_area=(0.0, 0.02),
    bob_drag_area=(0.0001, 0.001),
)
MASS = {"quadrotor_mass": (0.4, 0.8)}
ROWS = 2000


def drawn_parameters(ranges: Any, rows: int = ROWS, seed: int | None = 0, **kwargs: Any) -> Floats:
    """Return the parameters in the `info` of a first reset, shape (rows, 9)."""
    env = VectorParameterWrapper(make_vec(rows, **kwargs), ranges)
    return np.array(env.reset(seed=seed)[1]["parameters"])


def true_parameters(info: dict[str, Any]) -> Parameters:
    """Return the parameters in the `info` of a single environment."""
    return Parameters(*info["parameters"].tolist())


def test_each_parameter_is_uniform_in_its_interval() -> None:
    """The parameters are in the order of the fields of `Parameters`."""
    for name, values in zip(PARAMETER_NAMES, drawn_parameters(RANGES).T, strict=True):
        low, high = getattr(RANGES, name)
        assert stats.kstest((values - low) / (high - low), "uniform").pvalue > 0.001


def test_parameters_are_independent_across_parameters_sub_environments_and_episodes() -> None:
    env = VectorParameterWrapper(make_vec(ROWS), RANGES)
    episodes = [env.reset(seed=seed)[1]["parameters"].copy() for seed in (0, None, None)]
    correlations = np.corrcoef(np.concatenate(episodes, axis=1), rowvar=False)
    assert np.abs(correlations - np.eye(27)).max() < 5.0 / np.sqrt(ROWS)
    first = episodes[0]
    beside = np.corrcoef(first[1:], first[:-1], rowvar=False)[:9, 9:]
    assert np.abs(beside).max() < 5.0 / np.sqrt(ROWS)


def test_a_parameter_without_an_interval_has_its_nominal_value() -> None:
    parameters = drawn_parameters(MASS, 5, simulation={"parameters": UNEQUAL})
    assert_array_equal(parameters[:, 1:], np.tile(UNEQUAL.as_array()[1:], (5, 1)))
    assert len(np.unique(parameters[:, 0])) == 5


@pytest.mark.parametrize("name", PARAMETER_NAMES)
def test_an_interval_does_not_change_the_values_of_other_parameters(name: str) -> None:
    column = PARAMETER_NAMES.index(name)
    alone = drawn_parameters({name: getattr(RANGES, name)}, 5)
    assert_array_equal(alone[:, column], drawn_parameters(RANGES, 5)[:, column])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_every_episode_has_its_own_constant_parameters(mode: str) -> None:
    env: Any = VectorParameterWrapper(make_vec(3, autoreset_mode=mode, max_episode_steps=5), RANGES)
    single = ParameterWrapper(make_unwrapped(), RANGES)
    seeds = ([7, *[None] * 9], [8, *[None] * 9], [9, *[None] * 9])
    expected = np.array([[single.reset(seed=seed)[1]["parameters"].copy() for seed in row] for row in seeds])
    assert len(np.unique(expected)) == expected.size
    env.reset(seed=7)
    for _ in range(30):
        *_, info = env.step(np.zeros((3, 4)))
        assert_array_equal(info["parameters"], expected[range(3), env.unwrapped.world.episode])
    assert env.unwrapped.world.episode.min() >= 4


def test_final_info_reports_the_parameters_of_the_ended_episode() -> None:
    env: Any = VectorParameterWrapper(make_vec(3, autoreset_mode="SameStep", max_episode_steps=4), RANGES)
    before = env.reset(seed=0)[1]["parameters"].copy()
    *_, info = run_actions(env, np.zeros((4, 3, 4)))[-1]
    assert_array_equal(info["final_info"]["parameters"], before)
    assert_array_equal(info["parameters"], env.unwrapped.world.parameters)
    assert (info["parameters"] != before).all()


def test_the_parameters_in_info_are_a_copy() -> None:
    """The next episode does not change it, and changing it does not change the physics."""
    for env in (ParameterWrapper(make_unwrapped(), RANGES), VectorParameterWrapper(make_vec(2), RANGES)):
        world: Any = env.unwrapped.world  # type: ignore[attr-defined]
        _, info = env.reset(seed=0)
        kept, parameters = info["parameters"].copy(), world.parameters.copy()
        env.reset()
        assert_array_equal(info["parameters"], kept)
        _, info = env.reset(seed=0)
        info["parameters"][:] = 1.0
        assert_array_equal(world.parameters, parameters)


def test_the_initial_state_equals_that_of_an_environment_with_these_parameters() -> None:
    """It has the same deviations from the same reference."""
    for seed in range(5):
        uncertain = ParameterWrapper(make_unwrapped(), RANGES)
        _, info = uncertain.reset(seed=seed)
        certain = make_unwrapped(simulation={"parameters": true_parameters(info)})
        certain.reset(seed=seed)
        assert_array_equal(uncertain.unwrapped.state.array, certain.state.array)  # type: ignore[attr-defined]
        assert_array_equal(uncertain.unwrapped.world.reference, certain.world.reference)  # type: ignore[attr-defined]


def test_initial_states_references_and_wind_are_drawn_as_without_randomization() -> None:
    plain = make_vec(5, wind=WINDY)
    uncertain: Any = VectorParameterWrapper(make_vec(5, wind=WINDY), {"inertia_yaw": (0.05, 0.2), "bob_mass": (0.1, 1)})
    for seed in (0, None):
        plain.reset(seed=seed), uncertain.reset(seed=seed)
        assert_array_equal(uncertain.unwrapped.world.reference, plain.world.reference)
        assert_array_equal(uncertain.unwrapped.world.state[:, :6], plain.world.state[:, :6])
        results, expected = (run_actions(env, np.zeros((9, 5, 4))) for env in (uncertain, plain))
        assert_same([step[4]["disturbance"] for step in results], [step[4]["disturbance"] for step in expected])


def test_an_episode_equals_one_of_an_environment_with_these_parameters() -> None:
    """They are equal to the last bit. The weight is not drawn, because actions are scaled with its nominal value."""
    ranges = replace(RANGES, quadrotor_mass=None, bob_mass=None, gravity=None)
    wind = OrnsteinUhlenbeck(force=0.2, velocity=3.0)
    uncertain = ParameterWrapper(make_unwrapped(wind=wind), ranges)
    _, info = uncertain.reset(seed=2)
    certain = make_unwrapped(wind=wind, simulation={"parameters": true_parameters(info)})
    certain.reset(seed=2)
    actions = draw_actions(2, 20)
    results, expected = run_actions(uncertain, actions), run_actions(certain, actions)
    assert {info.pop("parameters").tobytes() for *_, info in results} == {certain.world.parameters.tobytes()}
    assert_same(results, expected)


def test_info_has_no_parameters_without_randomization() -> None:
    env = make_unwrapped()
    assert "parameters" not in env.reset(seed=0)[1]
    assert "parameters" not in env.step(np.zeros(4))[4]


def test_the_physics_uses_the_drawn_parameters_and_actions_the_nominal_ones() -> None:
    simulation = Simulation(UNEQUAL, period=1e-6)
    action = np.array([0.3, 0.2, -0.4, 0.5], np.float32)
    command = (np.array([1.0, 0.0, 0.0, 0.0]) + action) * simulation.command_scale  # with the nominal weight
    env = ParameterWrapper(make_unwrapped(simulation=simulation, task=ENDLESS), RANGES)
    for seed in range(5):
        _, info = env.reset(seed=seed, options={"state": {"velocity": (0.0, 0.0, 0.0), "direction": (0.3, -0.2, 0.9)}})
        state: State = env.unwrapped.state  # type: ignore[attr-defined]
        expected = accelerations(state.array, command, np.zeros(9), true_parameters(info))
        before = State(state.array.copy())
        env.step(action)
        for rate, acceleration in (
            ("velocity", expected.position),
            ("euler_rate", expected.euler),
            ("direction_rate", expected.direction),
        ):
            change = getattr(state, rate) - getattr(before, rate)
            assert_allclose(change / simulation.period, acceleration, rtol=1e-4, atol=1e-3)


def test_a_heavier_quadrotor_sinks_at_zero_action_and_a_lighter_one_rises() -> None:
    env: Any = VectorParameterWrapper(make_vec(50), MASS)
    _, info = env.reset(seed=0, options={"state": AT_REST})
    run_actions(env, np.zeros((10, 50, 4)))
    heavier = info["parameters"][:, 0] > PAPER.quadrotor_mass
    assert_array_equal(np.sign(env.unwrapped.world.state[:, 5]), np.where(heavier, -1.0, 1.0))


def test_single_and_vector_environments_draw_the_same() -> None:
    env = VectorParameterWrapper(make_vec(3), RANGES)
    single = ParameterWrapper(make_unwrapped(), RANGES)
    _, info = env.reset(seed=4)
    for row in range(3):
        assert_same(select_info(info, row), single.reset(seed=4 + row)[1])


def test_ranges_around_the_nominal_values() -> None:
    around = Around(0.2).ranges(PAPER)
    assert around.gravity is None
    for name in PARAMETER_NAMES:
        if name != "gravity":
            value = getattr(PAPER, name)
            assert_allclose(getattr(around, name), (0.8 * value, 1.2 * value), rtol=1e-15)
    some = Around(0.5, ("gravity", "rod_length")).ranges(UNEQUAL)
    assert_allclose(some.gravity, (4.905, 14.715))  # type: ignore[arg-type]
    assert_allclose(some.rod_length, (0.2, 0.6))  # type: ignore[arg-type]
    assert {name for name, value in asdict(some).items() if value} == {"gravity", "rod_length"}


def test_a_share_of_zero_gives_the_nominal_values() -> None:
    assert_array_equal(drawn_parameters(Around(0.0), 3), np.tile(PAPER.as_array(), (3, 1)))


def test_ranges_are_plain_data() -> None:
    for ranges in (RANGES, ParameterRanges(**MASS), Around(0.1)):
        data = json.loads(json.dumps(asdict(ranges)))
        assert_array_equal(drawn_parameters(data, 3), drawn_parameters(ranges, 3))
        assert as_ranges(data) == ranges


def test_a_share_refers_to_the_parameters_of_the_environment() -> None:
    simulation = Simulation(Parameters(inertia_roll=0.004))
    env = ParameterWrapper(make_unwrapped(simulation=simulation), Around(0.2))
    drawn = [env.reset(seed=seed)[1]["parameters"][PARAMETER_NAMES.index("inertia_roll")] for seed in range(20)]
    assert 0.0032 <= min(drawn) < max(drawn) <= 0.0048


def test_a_second_parameter_wrapper_is_refused() -> None:
    env = ParameterWrapper(make_unwrapped(), MASS)
    env.reset(seed=0)
    again = {"rod_length": (0.2, 0.3)}
    assert_refused_unchanged(env.unwrapped, lambda: ParameterWrapper(env, again), "drawn already", ValueError)
