"""The observation of a lab: places do not matter, jumps are jumps, and bad samples are not used."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.estimation.estimate import AGE, ANCHOR, HELD, LOOP
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.samples import COASTS, MOST_REFUSED, gain_row
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.sensors import SampleHold
from quadpend_gym.tasks.observation import LAB

ROWS = 3
SCENARIO = replace(SCENARIOS["flight_training_motion"], observation="lab")
HOVER = replace(SCENARIOS["flight_breeze"], observation="lab")
every_controller = pytest.mark.parametrize("name", ["lqg", "dual-mode", "adrc-tuned"])
MEASURED = LAB.select(["position", "quaternion", "direction"])


def flight(name: str, steps: int, change: Any = None, scenario: Scenario = SCENARIO) -> tuple[Any, Any, Floats32, Any]:
    """Fly; return the policy, its last memory, all actions and all observations, which `change(step, …)` changes.

    The environment goes on with the actions for the changed observations.
    """
    policy, env, memory, actions, seen = controller(name).adapt(scenario), scenario.make_vec(ROWS), None, [], []
    observation, _ = env.reset(seed=8)
    for step in range(steps):
        given = observation.copy()
        if change:
            change(step, given, seen)
        action, memory = policy.predict(given, memory, np.full(ROWS, step == 0))
        actions.append(action)
        seen.append(given)
        observation, *_ = env.step(action)
    return policy, memory, np.array(actions), np.array(seen)


def replay(policy: Any, seen: Floats32) -> Floats32:
    """Return the actions for observations, all of them."""
    actions, memory = [], None
    for step, observation in enumerate(seen):
        action, memory = policy.predict(observation, memory, np.full(ROWS, step == 0))
        actions.append(action)
    return np.array(actions)


@every_controller
def test_a_constant_added_to_position_and_reference_changes_no_action(name: str) -> None:
    policy, _, _, seen = flight(name, 150)
    places = [LAB.columns[field] for field in ("position", "reference_0")]
    for place in places:
        seen[..., place] = np.rint(2.0**16 * seen[..., place]) / 2.0**16  # so that sums are exact
    moved = seen.copy()
    for place in places:
        moved[..., place] += np.float32([16.0, -8.0, 4.0])
    assert_allclose(replay(policy, moved), replay(policy, seen), atol=1e-6)


def estimates(policy: Any, seen: Floats32, actions: Floats32) -> Any:
    """Return the memory after observations, with the actions of a flight, all of them."""
    memory = None
    for step, observation in enumerate(seen):
        memory = policy.update(observation, memory, np.full(ROWS, step == 0))
        memory = policy.with_applied_action(memory, actions[step])
    return memory


@every_controller
def test_a_jump_of_the_reference_is_not_taken_for_motion(name: str) -> None:
    """The action after a jump is that of an observer which has always seen the new reference."""
    policy, _, actions, seen = flight(name, 100, scenario=HOVER)
    jumped, other = seen.copy(), seen.copy()
    for field, jump in (("reference_0", (0.5, -0.25, 0.25)), ("yaw_reference", (0.5, 0.0, 0.0))):
        for changed in (jumped[50:], other):
            changed[..., LAB.columns[field]] += np.float32(jump)
    memories = [estimates(policy, observations, actions) for observations in (jumped, other)]
    found, expected = (memory.estimate for memory in memories)
    assert_allclose(found.relative, expected.relative, atol=1e-5)
    assert_allclose(found.disturbance, expected.disturbance, atol=1e-5)
    commands = [policy.control(memory)[0] for memory in memories]
    assert_allclose(*commands, atol=1e-3)


def hold(first: int, end: int, tells: bool, step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Hold the sample in some steps; it `tells` its age, or is frozen."""
    if first <= step < end:
        given[:, MEASURED] = seen[first - 1][:, MEASURED]
        given[:, LAB.columns["age"]] = tells * (step - first + 1) * SCENARIO.period / LAB.scale[LAB.columns["age"]]


def outliers(first: int, end: int, step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Move the measured position by 1 m in some steps."""
    if first <= step < end:
        given[:, LAB.columns["position"]] += np.float32([0.6, 0.8, 0.0])


def lose(first: int, end: int, step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Give no numbers in some steps."""
    if first <= step < end:
        given[:, MEASURED] = np.nan


@every_controller
@pytest.mark.parametrize(
    "change",
    [
        *(partial(hold, 60, 66, True), partial(hold, 60, 66, False), partial(lose, 60, 66)),
        *(partial(outliers, 60, 61), partial(outliers, 60, 64)),
    ],
    ids=["old", "frozen", "lost", "outlier", "outliers"],
)
def test_bad_samples_do_not_correct(name: str, change: Any) -> None:
    """The flight goes on nearly as with the good ones."""
    good, bad = flight(name, 90, scenario=HOVER), flight(name, 90, change, HOVER)
    assert_array_equal(bad[2][:60], good[2][:60])
    position = LAB.columns["position"]
    assert np.abs(bad[3][-1, :, position] - good[3][-1, :, position]).max() < 0.02


@pytest.mark.parametrize("name", ["lqg", "adrc-tuned"])
def test_the_estimate_begins_anew_where_the_samples_stay(name: str) -> None:
    """After five refused ones; the velocity and the forces are those before."""
    change = partial(outliers, 60, 1000)
    for steps, held in ((60 + MOST_REFUSED, MOST_REFUSED), (61 + MOST_REFUSED, 0)):
        _, memory, _, seen = flight(name, steps, change, HOVER)
        assert_array_equal(memory.estimate.array[:, HELD], held)
    found = memory.estimate.state[:, :3] + memory.estimate.array[:, ANCHOR : ANCHOR + 3]
    assert_allclose(found, seen[-1][:, LAB.columns["position"]], atol=1e-6)
    assert np.abs(memory.estimate.state[:, 3:6]).max() < 0.3
    assert np.abs(memory.estimate.disturbance).max() < 0.5


@every_controller
def test_an_estimate_that_begins_anew_keeps_rates_forces_and_the_actions_under_way(name: str) -> None:
    """They are those of an observer whose samples were lost where these jumped."""
    policy, _, actions, seen = flight(name, 61 + MOST_REFUSED, scenario=HOVER)
    arrays = []
    for change in (partial(lose, 60, 1000), partial(outliers, 60, 1000)):
        given = seen.copy()
        for step in range(60, len(given)):
            change(step, given[step], [])
        arrays.append(estimates(policy, given, actions).estimate.array)
    lost, anew = arrays
    rates, forces, under_way = [*range(3, 6), *range(9, 12), 15, 16], slice(18, 27), slice(LOOP, LOOP + 8)
    assert_allclose(anew[:, rates], lost[:, rates], atol=1e-3)
    assert_allclose(anew[:, forces], lost[:, forces], atol=1e-9)
    assert_array_equal(anew[:, under_way], lost[:, under_way])
    assert (np.abs(anew[:, under_way]).max(axis=1) > 0.0).all()


def test_the_gains_of_the_start_are_used_for_the_first_corrections_of_a_slow_sensor() -> None:
    """A sensor at 50 Hz takes as many corrections as one at 100 Hz, not as many periods."""
    slow = replace(HOVER, sensors=(*HOVER.sensors, SampleHold(0.02)))
    for scenario, corrections in ((HOVER, 20), (slow, 10)):
        _, memory, _, _ = flight("lqg", 21, scenario=scenario)
        assert_array_equal(memory.estimate.array[:, AGE], corrections)
    assert [gain_row(age, 1.0, 100 + COASTS) for age in (0.0, 9.0, 50.0, 500.0)] == [0, 9, 100, 100]
    assert [gain_row(age, 0.0, 100 + COASTS) for age in (0.0, 50.0, 500.0)] == [0, 50, 99]


def test_the_weight_of_a_pole_that_is_told_moves_between_force_and_mass() -> None:
    """Their sum in a correction, d̂_z − μ̂ (M + m) g with the believed m, does not depend on how fast it moves."""
    _, _, actions, seen = flight("lqg", 21, scenario=HOVER)
    seen[..., LAB.columns["pole"]] *= np.float32([1.0, 1.5])
    seen[20, :, LAB.columns["position"]] -= np.float32([0.0, 0.0, 0.01])
    p, memory, totals = HOVER.simulation.parameters, None, []
    for mass_time in (1.0, 1e-3):
        made: Any = controller("lqg", changes={"estimator.mass_time": mass_time})
        policy = made.designed_for(HOVER.simulation, Loop.known(HOVER))
        memory = memory or estimates(policy, seen[:20], actions)
        found = policy.update(seen[20], memory, None).estimate
        weight = (p.quadrotor_mass + 1.5 * p.bob_mass) * p.gravity
        totals.append(found.disturbance[:, 2] - found.mass_ratio[:, 0] * weight)
    assert_allclose(*totals, atol=1e-9)


def turn(step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Turn the measured attitude by half a turn in one step."""
    if step == 60:
        w, x, y, z = (LAB.columns["quaternion"].start + i for i in range(4))
        given[:, [w, x, y, z]] = given[:, [x, w, z, y]] * np.float32([-1.0, 1.0, -1.0, 1.0])


def mirror(step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Swap both ends of the pole in one step."""
    if step == 60:
        given[:, LAB.columns["direction"]] *= -1.0


def shift(step: int, given: Floats32, seen: list[Floats32]) -> None:
    """Move the measured position by 5 cm in one step."""
    if step == 60:
        given[:, LAB.columns["position"]] += np.float32([0.03, 0.04, 0.0])


@pytest.mark.parametrize("change", [turn, mirror, shift])
def test_one_wrong_attitude_pole_or_position_moves_the_vehicle_by_less_than_a_centimetre(change: Any) -> None:
    good, bad = flight("lqg", 90, scenario=HOVER), flight("lqg", 90, change, HOVER)
    position = LAB.columns["position"]
    assert np.abs(bad[3][61:, :, position] - good[3][61:, :, position]).max() < 0.01


def test_a_simulation_at_rest_is_not_blind() -> None:
    """Without noise all samples are equal: they count after 0.3 s."""
    policy, _, _, seen = flight("lqg", 1, scenario=replace(HOVER, sensors=(), wind=None))
    memory, held = None, []
    for step in range(60):
        memory = policy.update(seen[0], memory, np.full(ROWS, step == 0))
        held.append(memory.estimate.array[0, HELD])
    assert (max(held), held[-1]) == (30, 0)


def test_the_yaw_error_is_within_half_a_turn() -> None:
    policy, _, actions, seen = flight("lqg", 50, scenario=HOVER)
    turned = seen.copy()
    turned[25:, :, LAB.columns["yaw_reference"].start] += np.float32(2.0 * np.pi)
    assert_allclose(replay(policy, turned), actions, atol=1e-5)
