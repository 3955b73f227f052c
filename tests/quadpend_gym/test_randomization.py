"""Randomized parameters: their distribution, that `info` reports them, and that the physics uses them."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from quadpend_gym import PAPER, OrnsteinUhlenbeck, Parameters, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.randomization import Around, ParameterRanges
from quadpend_gym.vehicles import PARAMETER_NAMES, VEHICLES, Vehicle
from tests.helpers.envs import ENDLESS, assert_same, draw_actions, make_unwrapped, make_vec, run_actions
from tests.helpers.physics import rates

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


def drawn(ranges: Any, rows: int = ROWS, **kwargs: Any) -> Floats:
    """Return the parameters in the `info` of a first reset, shape (rows, 9)."""
    return np.array(make_vec(rows, parameters=ranges, **kwargs).reset(seed=0)[1]["parameters"])


def vehicle_of(p: Parameters) -> Vehicle:
    """Return the paper's vehicle with these parameters."""
    paper = VEHICLES["paper"]
    return replace(
        paper,
        mass=p.quadrotor_mass,
        gravity=p.gravity,
        inertia=(p.inertia_roll, p.inertia_pitch, p.inertia_yaw),
        drag=replace(paper.drag, area=p.quadrotor_drag_area),
        pole=replace(paper.pole, mass=p.bob_mass, length=p.rod_length, drag_area=p.bob_drag_area),
    )


def test_parameters_are_uniform_in_their_intervals_and_independent() -> None:
    """They are independent across parameters, sub-environments and episodes."""
    env = make_vec(ROWS, parameters=RANGES)
    episodes = [env.reset(seed=seed)[1]["parameters"].copy() for seed in (0, None, None)]
    for name, values in zip(PARAMETER_NAMES, episodes[0].T, strict=True):
        low, high = getattr(RANGES, name)
        assert stats.kstest((values - low) / (high - low), "uniform").pvalue > 0.001
    correlations = np.corrcoef(np.concatenate(episodes, axis=1), rowvar=False)
    assert np.abs(correlations - np.eye(27)).max() < 5.0 / np.sqrt(ROWS)
    beside = np.corrcoef(episodes[0][1:], episodes[0][:-1], rowvar=False)[:9, 9:]
    assert np.abs(beside).max() < 5.0 / np.sqrt(ROWS)


def test_a_parameter_without_an_interval_is_nominal_and_changes_no_other() -> None:
    vehicle, everything = VEHICLES["hummingbird"], drawn(RANGES, 5)
    parameters = drawn(MASS, 5, vehicle=vehicle)
    assert_array_equal(parameters[:, 1:], np.tile(vehicle.parameters.as_array()[1:], (5, 1)))
    for column, name in enumerate(PARAMETER_NAMES):
        assert_array_equal(drawn({name: getattr(RANGES, name)}, 5)[:, column], everything[:, column])


def test_every_episode_has_its_own_constant_parameters_in_single_and_vector_environments() -> None:
    env = make_vec(3, autoreset_mode="SameStep", duration=0.05, parameters=RANGES)
    single = make_unwrapped(parameters=RANGES)
    seeds = ([7, *[None] * 9], [8, *[None] * 9], [9, *[None] * 9])
    expected = np.array([[single.reset(seed=seed)[1]["parameters"].copy() for seed in row] for row in seeds])
    assert len(np.unique(expected)) == expected.size
    before = env.reset(seed=7)[1]["parameters"]
    for _ in range(30):
        *_, info = env.step(np.zeros((3, 4)))
        assert_array_equal(info["parameters"], expected[range(3), env.world.episode])
        if "final_info" in info:
            assert_array_equal(info["final_info"]["parameters"], before)
        before = info["parameters"].copy()
    assert env.world.episode.min() >= 4
    info["parameters"][:] = 1.0  # a copy
    assert (env.world.parameters != 1.0).all()


def test_an_episode_equals_one_of_a_vehicle_with_these_parameters() -> None:
    """They are equal to the last bit. The weight is not drawn, because actions are scaled with its nominal value."""
    ranges = replace(RANGES, quadrotor_mass=None, bob_mass=None, gravity=None)
    wind = OrnsteinUhlenbeck(force=0.2, velocity=3.0)
    uncertain = make_unwrapped(wind=wind, parameters=ranges)
    _, info = uncertain.reset(seed=2)
    certain = make_unwrapped(wind=wind, vehicle=vehicle_of(Parameters(*info["parameters"].tolist())))
    certain.reset(seed=2)
    actions = draw_actions(2, 20)
    results, expected = run_actions(uncertain, actions), run_actions(certain, actions)
    assert {info.pop("parameters").tobytes() for *_, info in results} == {certain.world.parameters.tobytes()}
    assert_same(results, expected)


def test_the_physics_uses_the_drawn_parameters_and_actions_the_nominal_ones() -> None:
    action, period = np.array([0.3, 0.2, -0.4, 0.5], np.float32), 1e-6
    env = make_unwrapped(period=period, task=ENDLESS, parameters=RANGES)
    command = (np.array([1.0, 0.0, 0.0, 0.0]) + action) * env.scenario.simulation.command_scale
    for seed in range(5):
        _, info = env.reset(seed=seed, options={"state": {"velocity": (0.0, 0.0, 0.0), "direction": (0.3, -0.2, 0.9)}})
        true = Parameters(*info["parameters"].tolist())
        expected, before = rates(env.state.array, command, np.zeros(9), true), State(env.state.array.copy())
        env.step(action)
        for rate in ("velocity", "euler_rate", "direction_rate"):
            change = getattr(env.state, rate) - getattr(before, rate)
            assert_allclose(change / period, getattr(expected, rate)[0], rtol=1e-4, atol=1e-3)


def test_ranges_around_the_nominal_values_are_those_of_the_vehicle() -> None:
    around = Around(0.2).ranges(PAPER)
    assert around.gravity is None
    for name in set(PARAMETER_NAMES) - {"gravity"}:
        value = getattr(PAPER, name)
        assert_allclose(getattr(around, name), (0.8 * value, 1.2 * value), rtol=1e-15)
    some = Around(0.5, ("gravity", "rod_length")).ranges(PAPER)
    assert {name for name, value in asdict(some).items() if value} == {"gravity", "rod_length"}
    nominal = VEHICLES["crazyflie"].parameters.as_array()
    ratio = drawn(Around(0.2), 50, vehicle="crazyflie")[:, nominal > 0.0] / nominal[nominal > 0.0]
    assert 0.8 <= ratio.min() < 0.9 < 1.1 < ratio.max() <= 1.2
