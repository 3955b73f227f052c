"""Loops with constants drawn for each episode: their distribution, and equality with fixed loops."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import OrnsteinUhlenbeck, Scenario, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import Streams
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.randomization import LOOP_NAMES, LoopRanges
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.envs import (
    ENDLESS,
    assert_same,
    draw_actions,
    make_unwrapped,
    make_vec,
    rewards,
    run_actions,
    select_info,
)
from tests.helpers.rigid import random_vehicle

PAPER: dict[str, Any] = {"task": ENDLESS, "wind": OrnsteinUhlenbeck(force=0.2, velocity=3.0)}
HUMMINGBIRD: dict[str, Any] = {**PAPER, "vehicle": "hummingbird", "interface": "body_rates", "latency": 0.02}
LOOP: dict[str, Any] = {
    "latency": (0.0, 0.04),
    "jitter": 0.004,
    "rate_loop": (0.8, 1.2),
    "rotor_lag": (0.7, 1.3),
    "thrust": (0.8, 1.2),
}
CHANGES: dict[str, Any] = {"at": (0.03, 0.07), "thrust": (0.5, 0.8)}
both_vehicles = pytest.mark.parametrize("fields", [PAPER, HUMMINGBIRD], ids=["paper", "hummingbird"])


def drawn(loop: Any, rows: int, **fields: Any) -> Floats:
    """Return the constants of the loop in the `info` of a first reset, shape (rows, 4)."""
    return np.array(make_vec(rows, loop=loop, **fields).reset(seed=0)[1]["loop"])


def flown(steps: int = 20, **fields: Any) -> Any:
    """Return what the steps of an episode returned, without the loop in `info`."""
    env = make_unwrapped(**fields)
    env.reset(seed=1)
    results = run_actions(env, 0.3 * draw_actions(3, steps))
    for *_, info in results:
        info.pop("loop", None)
    return results


def test_constants_are_drawn_in_their_intervals_and_each_by_itself() -> None:
    everything = drawn(LOOP, 500, **HUMMINGBIRD)
    assert_allclose(everything[:, 0] / 0.005, np.rint(everything[:, 0] / 0.005), atol=1e-9)
    for name, values in zip(LOOP_NAMES, everything.T, strict=True):
        low, high = LOOP[name]
        reach = 0.05 * (high - low)
        assert low <= values.min() <= low + reach
        assert high - reach <= values.max() <= high
    assert_array_equal(drawn(LOOP, 3, **HUMMINGBIRD), everything[:3])
    alone = drawn({"rotor_lag": LOOP["rotor_lag"]}, 3, **HUMMINGBIRD)
    assert_array_equal(alone, np.stack([np.full(3, 0.02), np.ones(3), everything[:3, 2], np.ones(3)], axis=1))


@both_vehicles
@pytest.mark.parametrize("latency", [0.0, 0.005, 0.02, 0.035])
def test_an_episode_equals_one_with_its_latency_fixed(fields: dict[str, Any], latency: float) -> None:
    assert_same(flown(**fields, loop={"latency": (latency, latency)}), flown(**{**fields, "latency": latency}))


def test_an_episode_equals_one_of_a_vehicle_with_its_time_constants() -> None:
    vehicle = VEHICLES["hummingbird"]
    assert vehicle.rotors is not None
    loop, rotors = vehicle.rate_loop, replace(vehicle.rotors, lag_up=1.3 * vehicle.rotors.lag_up)
    slow = replace(vehicle, rotors=rotors, rate_loop=replace(loop, time_constant=0.9 * loop.time_constant))
    found = flown(**HUMMINGBIRD, loop={"rotor_lag": (1.3, 1.3), "rate_loop": (0.9, 0.9)})
    assert_same(found, flown(**{**HUMMINGBIRD, "vehicle": slow}))


@pytest.mark.parametrize("vehicle", ["paper", random_vehicle(0, with_rotors=False, pivot=(0.0, 0.0, 0.05))])
def test_thrust_and_torques_are_scaled(vehicle: Any) -> None:
    """Half of them is what half of every command makes."""
    half, full = (make_unwrapped(task=ENDLESS, vehicle=vehicle, loop={"thrust": (x, x)}) for x in (0.5, 1.0))
    for env in (half, full):
        env.reset(seed=1)
    for action in np.rint(64.0 * draw_actions(3, 10)).astype(np.float32) / np.float32(128.0):
        half.step(action)
        full.step(np.float32(0.5) * (action - np.array([1.0, 0.0, 0.0, 0.0], np.float32)))
        assert_array_equal(half.world.state, full.world.state)


def test_jitter_keeps_the_mean_of_the_latency_and_the_order_of_the_actions() -> None:
    simulation, rows, steps = Simulation(substeps=10), 200, 200
    loops = Schedule(LoopRanges(latency=(0.004, 0.03), jitter=0.004), simulation, rows)
    loops.start_episodes(np.arange(rows), Streams.from_seeds([*range(rows)]))
    acting = []
    for step in range(steps):
        loops.advance(np.full(rows, step))
        acting.append(1.0 + step - loops.ages)
        assert loops.ages.max() < loops.slots
    number = np.concatenate(acting)  # one more than that of the action that acts in each substep
    assert (np.diff(number, axis=0) >= 0.0).all()
    begins = np.array([np.argmax(number >= 1 + step, axis=0) - 10 * step for step in range(steps - 10)])
    latency = np.rint(1000.0 * loops.drawn[0])
    assert_allclose(begins.mean(axis=0), latency, atol=0.8)  # ms
    assert_allclose((begins.mean(axis=0) - latency).mean(), 0.0, atol=0.05)
    assert np.abs(begins - latency).max() == 4.0
    assert 2.0 < (begins - latency).std() < 2.6  # 2.3 ms of jitter, 0.4 ms of rounding


@both_vehicles
def test_a_change_from_the_beginning_is_the_loop_of_the_episode(fields: dict[str, Any]) -> None:
    constants = {"latency": (0.035, 0.035), "thrust": (0.8, 0.8)}
    assert_same(flown(**fields, loop={"changes": {"at": (0.0, 0.0), **constants}}), flown(**fields, loop=constants))


def test_a_change_begins_at_the_control_step_at_or_after_its_time() -> None:
    """Until then the loop is nominal; from then on `info` has the changed thrust, and one rotor is weaker."""
    changes = {"at": (0.02, 0.08), "thrust": (0.7, 0.9), "rotors": (0.75, 0.75)}
    env = make_vec(200, **HUMMINGBIRD, loop={"changes": changes})
    env.reset(seed=0)
    thrust, efficiency = [], []
    for action in 0.1 * draw_actions(0, 10, 200):
        thrust.append(env.step(action)[4]["loop"][:, 3])
        efficiency.append(env.world.schedule.loops[:4].T.copy())
    changed, shares = np.not_equal(thrust, 1.0), np.array(efficiency) / np.array(thrust)[..., np.newaxis]
    assert_array_equal(np.sort(changed, axis=0), changed)  # it stays
    assert set(10 - changed.sum(axis=0)) == {3, 4, 5, 6, 7, 8}
    assert (np.abs(np.array(thrust)[changed] - 0.8) <= 0.1).all()
    assert_allclose(np.sort(shares[changed], axis=1), np.tile([0.75, 1.0, 1.0, 1.0], (changed.sum(), 1)))
    assert set(shares[-1].argmin(axis=1)) == {0, 1, 2, 3}
    assert (shares[~changed] == 1.0).all()


@pytest.mark.parametrize(("before", "after"), [(0.02, 0.037), (0.035, 0.0)])
def test_actions_issued_from_the_change_on_have_the_changed_latency(before: float, after: float) -> None:
    """An action never acts before the one that was issued before it."""
    ranges = LoopRanges(latency=(before, before), changes={"at": (0.051, 0.051), "latency": (after, after)})
    loops, substeps = Schedule(ranges, Simulation(substeps=10), 1), 10
    loops.start_episodes(np.arange(1), Streams.from_seeds([0]))
    number = []
    for step in range(20):
        loops.advance(np.full(1, step))
        number.append(1.0 + step - loops.ages[:, 0])
    acting = np.concatenate(number)
    begins = np.array([np.argmax(acting >= 1 + step) for step in range(15)])
    latency = np.where(np.arange(15) < 6, before, after) * 1000
    assert_array_equal(begins, np.maximum.accumulate(substeps * np.arange(15) + np.rint(latency)))


@both_vehicles
def test_rows_equal_single_environments_with_autoreset_and_threads(fields: dict[str, Any]) -> None:
    """They are equal to the last bit; 130 rows are three blocks."""
    loop = dict(LOOP) if "vehicle" in fields else {name: LOOP[name] for name in ("latency", "jitter", "thrust")}
    loop["changes"] = CHANGES | ({"rotors": (0.5, 0.9), "latency": (0.0, 0.05)} if "vehicle" in fields else {})
    fields = {**fields, "loop": loop, "duration": 0.08}
    one, two = (make_vec(130, autoreset_mode="SameStep", num_threads=n, **fields) for n in (1, 2))
    single, row = make_unwrapped(**fields), 97
    first = single.reset(seed=5 + row)
    seen, _ = one.reset(seed=5)
    two.reset(seed=5)
    assert_array_equal(seen[row], first[0])
    actions = draw_actions(0, 30, 130)
    results = run_actions(one, actions)
    assert_same(run_actions(two, actions), results)
    for action, (observation, reward, _, truncated, info) in zip(actions, results, strict=True):
        expected: Any = single.step(action[row])
        assert reward[row] == expected[1]
        if truncated[row]:
            assert_same(select_info(info["final_info"], row), expected[4])
            expected = single.reset()
        assert_array_equal(observation[row], expected[0])
        assert_array_equal(info["loop"][row], expected[-1]["loop"])


@pytest.mark.parametrize(
    ("loop", "fields", "sentence"),
    [
        ({}, PAPER, "at least one of latency, rate_loop, rotor_lag, thrust, jitter and changes must be given"),
        (
            {"thrust": (1.2, 0.8)},
            PAPER,
            r"thrust: the numbers must be in the order \(lowest, highest\), not \(1.2, 0.8\)",
        ),
        ({"latency": (-0.01, 0.01)}, PAPER, "from 0 to 1 s"),
        ({"delay": (0.0, 0.01)}, PAPER, "no field 'delay'"),
        ({"rate_loop": (0.8, 1.2)}, PAPER, "loop.rate_loop needs the interface 'body_rates'"),
        ({"rotor_lag": (0.8, 1.2)}, PAPER, "loop.rotor_lag needs rotors with a lag"),
        ({"changes": {"at": (1.0, 2.0)}}, PAPER, "loop.changes: at least one of latency, thrust and rotors must"),
        ({"changes": {"at": (1.0, 2.0), "rotors": (0.7, 0.7)}}, PAPER, "loop.changes.rotors needs rotors, which"),
        ({"changes": {"thrust": (0.7, 0.7)}}, PAPER, "lacks the field 'at'"),
        ({"rotor_lag": (1.0, 3.0)}, HUMMINGBIRD, "at least half the rotors' lag of 0.045 s, not 0.02 s"),
    ],
)
def test_a_wrong_loop_is_refused_in_one_sentence(loop: Any, fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Scenario(**{**fields, "loop": loop})


def test_every_constant_changes_the_flight() -> None:
    for name, value in LOOP.items():
        loop = {name: (value[1], value[1]) if name != "jitter" else value}
        assert not np.array_equal(rewards(flown(**HUMMINGBIRD, loop=loop)), rewards(flown(**HUMMINGBIRD)))
