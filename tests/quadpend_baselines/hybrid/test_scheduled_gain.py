"""The filter of a network: it predicts as the plant moves, corrects as the observer of `lqg`, and bears jumps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpend_baselines.controllers.lqg import evaluate
from quadpend_baselines.estimation.estimate import nominal
from quadpend_baselines.estimation.kalman import MEASURED_COLUMNS, VARYING_STEPS
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import scheduled_gain as filters
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.hybrid.lab import FILTER, REACH, lab_part
from quadpend_baselines.hybrid.parts import Seen
from quadpend_baselines.hybrid.scheduled_gain import NOISE, SIZE, WIND, memory_size, observe, scheduled_gain
from quadpend_baselines.modelling.linear_model import (
    DISTURBANCE_COLUMNS,
    MODEL_BOB_FORCE,
    MODEL_FORCE,
    MODEL_STATE_SIZE,
    STATE_COLUMNS,
    rotate,
    rotate_state,
)
from quadpend_baselines.registry import controller
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import make_rigid_settings
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.tasks.observation import LAB
from quadpend_gym.vehicles import Drag

BREEZE, ROWS = find_scenario("flight_breeze"), 4
VEHICLE = replace(
    BREEZE.simulation.vehicle,
    pivot=(0.02, -0.03, 0.15),
    pole=replace(BREEZE.simulation.vehicle.pole, mass=0.2, inertia=0.02),
    drag=Drag(area=0.1, rotor=(0.3, 0.2, 0.5), angular=(0.002, 0.003, 0.004), height=0.05),
)
PLACE, YAW, HEADING, COASTED, AGE, UNDER_WAY = (
    getattr(filters, name) for name in ("_PLACE", "_YAW", "HEADING", "_COASTED", "_AGE", "_UNDER_WAY")
)

NEW, NONE = (0.0, 1.0, 1.0, 0.0), (0.0, 0.0, 1.0, 0.0)  # samples in the course of an episode


def observed(simulation: Simulation, memory: Floats, action: Floats, reference: Floats, y: Any, sample: Any) -> Any:
    """Return x when the next action acts, i, and the next memory."""
    rows = len(memory)
    later, innovation, after = np.empty((rows, SIZE)), np.empty((rows, len(MEASURED_COLUMNS))), np.empty_like(memory)
    given = np.ascontiguousarray(y, np.float64), np.tile(np.array(sample, np.float64), (rows, 1)), reference, action
    observe(scheduled_gain(simulation), *given, memory, after, later, innovation)
    return later, innovation, after


def in_axes(state: Floats, vehicle: Floats, heading: Floats, reference: Floats, simulation: Simulation) -> Floats:
    """Return x without the wind for states of the plant, in the axes of a heading."""
    x = state.copy()
    x[:, :3] -= reference[:, :3]
    x[:, 8] -= reference[:, 3]
    x = rotate_state(x[:, STATE_COLUMNS], -heading)
    x[:, 9:12] = vehicle[:, BODY_RATE : BODY_RATE + 3]
    return np.hstack([x, vehicle[:, ROTOR_THRUST:] - np.array(make_rigid_settings(simulation).rotors.hover)])


@pytest.mark.parametrize(
    "simulation",
    [
        replace(BREEZE.simulation, latency=0.0),
        BREEZE.simulation,
        replace(BREEZE.simulation, vehicle=VEHICLE),
    ],
    ids=["no latency", "latency", "another vehicle"],
)
def test_it_predicts_the_motion_of_the_plant(simulation: Simulation) -> None:
    """Rolled and pitched by up to 46°, in wind, turning, with thrusts at their limits; the reference moves too."""
    rng, rows, weight = np.random.default_rng(0), 40, simulation.parameters.hover_thrust
    plant, periods = plant_of(simulation), 1 + round(simulation.latency / simulation.period)

    def drawn(size: int, scale: float = 1.0) -> Floats:
        return scale * rng.uniform(-1.0, 1.0, (rows, size))

    state = np.zeros((rows, STATE_SIZE))
    x = State(state)
    x.position[:], x.velocity[:], x.euler[:, :2], x.euler[:, 2:] = drawn(3), drawn(3, 3.0), drawn(2, 0.8), drawn(1, 3.0)
    x.euler_rate[:], x.direction[:, :2], x.direction[:, 2] = drawn(3, 2.0), drawn(2, 0.5), 1.0
    x.direction[:] /= np.linalg.norm(x.direction, axis=1, keepdims=True)
    x.direction_rate[:] = np.cross(drawn(3, 3.0), x.direction)
    vehicle, heading = plant.initial_memory(state), x.euler[:, 2].copy()
    vehicle[:, ROTOR_THRUST:] += drawn(4, 0.1 * weight)
    wind = np.hstack([drawn(3, 0.1 * weight), drawn(2, 0.03 * weight), np.zeros((rows, 3))])
    reference, actions, memory = drawn(4), drawn(4 * periods), np.zeros((rows, memory_size(simulation)))
    memory[:, :WIND], memory[:, WIND:SIZE] = in_axes(state, vehicle, heading, reference, simulation), wind
    memory[:, PLACE : YAW + 1], memory[:, HEADING], memory[:, UNDER_WAY:] = reference, heading, actions[:, :-4]
    reference = reference + drawn(4, 0.1)
    action = np.ascontiguousarray(actions[:, -4:])
    later, innovation, after = observed(simulation, memory, action, reference, np.zeros((rows, 16)), NONE)
    disturbance = np.zeros((rows, DISTURBANCE_SIZE))
    disturbance[:, DISTURBANCE_COLUMNS] = rotate(wind, heading, MODEL_FORCE.start, MODEL_BOB_FORCE.start)
    start = in_axes(state, vehicle, after[:, HEADING], reference, simulation)
    for k in range(periods):
        parameters = np.tile(simulation.parameters.as_array(), (rows, 1))
        plant.advance(state, vehicle, actions[:, 4 * k : 4 * k + 4], disturbance.copy(), parameters)
    expected = in_axes(state, vehicle, after[:, HEADING], reference, simulation)
    error, moved = (np.sqrt((item**2).mean(0)) for item in (later[:, :WIND] - expected, expected - start))
    assert (innovation == 0.0).all()
    turned = rotate(wind, heading - after[:, HEADING], MODEL_FORCE.start, MODEL_BOB_FORCE.start)
    np.testing.assert_allclose(later[:, WIND:], turned, atol=1e-12)
    assert (error < 0.03 * moved).all(), error / moved
    assert (error[[0, 1, 2, 12, 13]] < 1e-3 * moved[[0, 1, 2, 12, 13]]).all(), error / moved


def test_its_gains_are_those_of_lqg() -> None:
    """In the first corrections, after coasts, and in gusts; between those of its tables they lie on lines."""
    simulation, size = replace(BREEZE.simulation, latency=0.0), len(MEASURED_COLUMNS)
    law: Any = controller("lqg").designed_for(simulation, Loop(noise=NOISE, observation=LAB))
    table, last = law.estimator.tables[0], VARYING_STEPS - 1
    calm, more = table[:, :, MEASURED_COLUMNS], table[last][:, MODEL_STATE_SIZE + MEASURED_COLUMNS]
    gust = 0.02 * simulation.parameters.bob_mass * simulation.parameters.gravity
    cases = [
        *((age, 0.0, 0.0, calm[age]) for age in (0, 1, 2, 4, 8, 16)),
        (12.0, 0.0, 0.0, 0.5 * (calm[8] + calm[16])),
        *((30.0, coast, 0.0, calm[last + coast]) for coast in (0, 4, 10, 30)),
        (30.0, 7.0, 0.0, 0.5 * (calm[last + 4] + calm[last + 10])),
        (30.0, 0.0, gust * np.sqrt(0.5), calm[last] + 0.5 * more),
        (30.0, 4.0, 2.0 * gust, calm[last + 4] + more),
    ]
    assert np.abs(more).max() > 1.0
    for age, coast, force, gain in cases:
        memory, none = np.zeros((size, memory_size(simulation))), np.zeros((size, 4))
        memory[:, AGE], memory[:, COASTED], memory[:, WIND + MODEL_BOB_FORCE.start + 1] = age, 0.01 * coast, force
        y = observed(simulation, memory, none, none, np.zeros((size, 16)), NONE)[0]
        off = 1e-3 * np.eye(size)  # one measured number after the other
        y[:, MEASURED_COLUMNS] += off
        corrected, innovation, _ = observed(simulation, memory, none, none, y[:, :16], (y[0, 8], 1.0, 1.0, 0.0))
        np.testing.assert_allclose(innovation, off, atol=1e-12)
        y[:, MEASURED_COLUMNS] -= off
        found = (corrected - y).T / 1e-3
        np.testing.assert_allclose(found[np.r_[:MODEL_STATE_SIZE, WIND:SIZE]], gain, atol=1e-3 * np.abs(gain).max())
        assert (found[MODEL_STATE_SIZE:WIND] == 0.0).all()


def test_an_innovation_counts_up_to_a_limit_that_grows_without_samples() -> None:
    simulation = replace(BREEZE.simulation, latency=0.0)
    for since, limit in ((0.0, 0.05), (0.1, 0.35)):
        memory, none = np.zeros((1, memory_size(simulation))), np.zeros((1, 4))
        memory[:, COASTED] = since
        for y in (-2.0, 2.0):
            _, innovation, _ = observed(simulation, memory, none, none, np.full((1, 16), y), NEW)
            np.testing.assert_allclose(innovation, np.sign(y) * limit)


@pytest.mark.parametrize(
    "wrong",
    [{0: 0.5}, {0: 5.0}, {4: 10.0}, {6: 1.2}, {9: 10.0}, {13: 0.8}, {0: 0.7, 3: 2.0, 6: 0.8, 9: 5.0, 12: 0.6, 14: 3.0}],
    ids=str,
)
def test_it_recovers_from_a_wrong_state(wrong: dict[int, float]) -> None:
    """Of a vehicle at rest. While an innovation is beyond its limit, limit and gain grow as without samples."""
    simulation = BREEZE.simulation
    memory, none, x = np.zeros((1, memory_size(simulation))), np.zeros((1, 4)), np.empty(0)
    memory[0, [*wrong]], memory[:, AGE] = [*wrong.values()], 30.0
    for _ in range(100):
        x, _, memory = observed(simulation, memory, none, none, np.zeros((1, 16)), NEW)
    np.testing.assert_allclose(x[0, :3], 0.0, atol=0.005)
    np.testing.assert_allclose(x[0, 6:9], 0.0, atol=0.005)
    np.testing.assert_allclose(memory[:, COASTED], 0.0)


def test_a_step_of_the_measurements_replaces_what_they_measure() -> None:
    """Of a vehicle that turned; rates, thrusts and wind are as without a sample."""
    simulation, rng = replace(BREEZE.simulation, latency=0.0), np.random.default_rng(0)
    memory, y = rng.uniform(-0.5, 0.5, (3, memory_size(simulation))), rng.uniform(-0.5, 0.5, (3, 16))
    memory[:, COASTED], memory[:, AGE] = 0.1, 30.0
    action, reference = rng.uniform(-0.5, 0.5, (2, 3, 4))
    coasting, _, _ = observed(simulation, memory, action, reference, y, NONE)
    x, innovation, after = observed(simulation, memory, action, reference, y, (0.7, 1.0, 1.0, 1.0))
    np.testing.assert_array_equal(x[:, MEASURED_COLUMNS], y[:, MEASURED_COLUMNS])
    turned = [9, 10, 11, *range(MODEL_STATE_SIZE, WIND), SIZE - 1]  # what has no axes of the heading
    np.testing.assert_allclose(x[:, turned], coasting[:, turned], atol=1e-12)
    for first in (3, 14, WIND):
        lengths = [np.hypot(*item[:, first : first + 2].T) for item in (x, coasting)]
        np.testing.assert_allclose(*lengths, atol=1e-12)
    assert (innovation == 0.0).all()
    assert (after[:, COASTED] == 0.0).all()


def flown(scenario: Scenario, steps: int, change: Any = None) -> tuple[Any, Any, Any]:
    """Return z of `lqg` and of the filter, and its innovations, while `lqg` flies on changed observations."""
    policy: Any = controller("lqg").designed_for(scenario.simulation, Loop.known(scenario))
    part, env = lab_part(scenario.simulation), scenario.make_vec(ROWS)
    observation, _ = env.reset(seed=7)
    own, action, started = np.zeros((ROWS, part.memory_size)), np.zeros((ROWS, 4), np.float32), np.ones(ROWS, np.bool_)
    memory, expected, found = None, [], []
    for step in range(steps):
        memory = policy.update(observation, memory, started)
        given = change(step, observation.copy()) if change else observation
        inputs, own = part.function(part.numbers, Seen(given, action, *[np.zeros((ROWS, 4))] * 3), own)
        later = policy.estimator.prediction.carry_forward(memory.estimate, memory.action)
        expected.append(evaluate(policy._law, nominal(later))[2])
        found.append(inputs[:, FILTER])
        action, memory = policy.control(memory)
        memory = policy.with_applied_action(memory, action)
        observation, _, _, _, _ = env.step(action)
        started = np.zeros(ROWS, np.bool_)
    states = np.array(found)[..., :SIZE] * deviation_scales(scenario.simulation.parameters.hover_thrust)[4:32]
    return np.array(expected), states, np.array(found)[..., SIZE : SIZE + 8]


@pytest.mark.parametrize("name", ["flight_breeze", "flight_training_wide", "event_turning"])
def test_it_is_the_observer_of_lqg(name: str) -> None:
    """From the start, near hover, on a reference and turning, there with drop-outs of 300 ms."""
    scenario = find_scenario(name)
    if name == "event_turning":
        bursts = {"kind": "bursts", "length": [0.3, 0.3], "pause": [0.8, 1.0]}
        noise = {"kind": "noise", "position": 0.0005, "euler": {"white": 0.001, "bias": 0.01}, "direction": 0.0006}
        scenario = as_scenario(name, sensors=[noise, bursts])
    expected, states, innovation = (item[..., :16] for item in flown(scenario, 300))
    error = np.sqrt(((states - expected) ** 2).mean((0, 1)) / (expected**2).mean((0, 1)))
    assert (error < 0.05).all(), error
    assert np.abs(states - expected)[..., :3].max() < 1.5e-3
    if name == "event_turning":
        assert (innovation == 0.0).all(2).mean() > 0.2
        assert np.abs(expected)[..., :3].max() > 0.04


@pytest.mark.parametrize(("field", "distance"), [("reference_0", 0.5), ("reference_0", 8.0), ("yaw_reference", 3.3)])
def test_a_jump_of_the_reference_is_no_motion(field: str, distance: float) -> None:
    """Tracking error and yaw jump alone: no velocity, and no innovation, which is as large as before."""

    def jumped(step: int, observation: Any) -> Any:
        observation[:, LAB.columns[field].start] += distance * (step >= 50)
        return observation

    _, still, noise = flown(BREEZE, 56)
    _, states, innovation = flown(BREEZE, 56, jumped)
    np.testing.assert_allclose(states[50:, :, 3:8], still[50:, :, 3:8], atol=2e-3)
    np.testing.assert_allclose(np.abs(innovation).max(), np.abs(noise).max(), rtol=0.1)
    distance = min(distance, REACH) if field == "reference_0" else distance
    moved = states[50, :, 8] - still[50, :, 8] if field == "yaw_reference" else np.hypot(*states[50, :, :2].T)
    np.testing.assert_allclose(np.abs(moved), distance, rtol=0.1)


def test_the_latency_is_in_the_memory() -> None:
    simulation = BREEZE.simulation
    sizes = [memory_size(replace(simulation, latency=latency)) for latency in (0.0, 0.02, 0.03)]
    assert np.diff(sizes).tolist() == [8, 4]
