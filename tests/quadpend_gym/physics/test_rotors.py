"""Rotors and the on-board rate loop: allocation, lag, rates, interfaces, and hover of every vehicle."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import linprog

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import make_rigid_settings, pack_rigid, unpack_rigid
from quadpend_gym.physics.rotors import allocate
from quadpend_gym.physics.vectors import load_four, store_four
from quadpend_gym.vehicles import VEHICLES, Pole, RateLoop, Simulation, Vehicle, mixing, rotors_of
from tests.helpers.random_settings import INTERFACES
from tests.helpers.rigid import at_rest, random_vehicle, start

PRESETS = [name for name, vehicle in VEHICLES.items() if vehicle.attitude == "rigid"]
LIGHT = Pole(1e-5, 0.01)


@compiled
def _allocate(wrench: Floats, packed: Floats, out: Floats) -> None:
    rotors = unpack_rigid(packed).rotors
    for column in range(wrench.shape[1]):
        store_four(out, 0, column, allocate(load_four(wrench, 0, column), rotors))


def allocated(wrench: Floats, vehicle: Vehicle) -> Floats:
    """Return the rotor thrusts for wrenches of shape (n, 4), shape (n, 4)."""
    out = np.empty((4, len(wrench)))
    _allocate(np.ascontiguousarray(wrench.T), pack_rigid(Simulation(vehicle=vehicle)), out)
    return out.T


def draw_wrenches(vehicle: Vehicle, rows: int, seed: int) -> Floats:
    """Draw thrusts and torques, about half of them out of reach, shape (rows, 4)."""
    low, high = rotors_of(vehicle).thrust
    rng = np.random.default_rng([8, seed])
    within = rng.uniform(low, high, (rows, 4)) @ mixing(vehicle).T
    return np.asarray(within * rng.choice([0.3, 1.0, 2.0], (rows, 4)))


@pytest.mark.parametrize("seed", range(5))
def test_a_reachable_wrench_is_allocated_exactly_and_every_thrust_is_within_its_limits(seed: int) -> None:
    vehicle = random_vehicle(seed, with_rotors=True)
    wrenches = draw_wrenches(vehicle, 500, seed)
    low, high = rotors_of(vehicle).thrust
    thrusts, exact = allocated(wrenches, vehicle), np.linalg.solve(mixing(vehicle), wrenches.T).T
    reachable = np.all((exact >= low) & (exact <= high), axis=-1)
    assert 20 < reachable.sum() < 480
    assert_allclose(thrusts[reachable], exact[reachable], rtol=1e-9)
    assert thrusts.min() >= low
    assert thrusts.max() <= high


@pytest.mark.parametrize("seed", range(5))
def test_yaw_is_given_up_first_then_thrust_then_roll_and_pitch(seed: int) -> None:
    """A linear programme finds the largest share of roll and pitch, and the nearest thrust, that are reachable."""
    vehicle = random_vehicle(seed, with_rotors=True)
    low, high = rotors_of(vehicle).thrust
    lift, roll, pitch, yaw = np.linalg.inv(mixing(vehicle)).T
    wrenches = draw_wrenches(vehicle, 40, seed)
    exact = np.linalg.solve(mixing(vehicle), wrenches.T).T
    for wrench in wrenches[np.any((exact < low) | (exact > high), axis=-1)]:
        thrust, *tilt, turn = mixing(vehicle) @ allocated(wrench[np.newaxis], vehicle)[0]
        wanted = wrench[1] * roll + wrench[2] * pitch
        # Variables: share of the tilt and total thrust, without yaw.
        sides = np.concatenate([np.column_stack([wanted, lift]), -np.column_stack([wanted, lift])])
        bounds = np.concatenate([np.full(4, high), np.full(4, -low)])
        solution = linprog([-1.0, 0.0], sides, bounds, bounds=[(0.0, 1.0), (None, None)]).x
        assert solution is not None
        share = solution[0]
        assert_allclose(tilt, share * wrench[1:3], rtol=1e-6, atol=1e-9)
        room = np.sort(np.array([low, high])[:, None] - share * wanted, axis=0) / lift
        nearest = np.clip(wrench[0], room[0].max() - 1e-9, room[1].min() + 1e-9)
        assert thrust == pytest.approx(nearest, rel=1e-6)
        left = (np.where(wrench[3] * yaw > 0.0, high, low) - share * wanted - nearest * lift) / (wrench[3] * yaw)
        assert turn == pytest.approx(np.clip(left.min(), 0.0, 1.0) * wrench[3], rel=1e-5, abs=1e-7)


def test_thrusts_follow_their_commands_as_first_order_lags_that_differ_up_and_down() -> None:
    vehicle = random_vehicle(1, with_rotors=True)
    rotors = replace(rotors_of(vehicle), lag_up=0.03, lag_down=0.08)
    simulation = Simulation(vehicle=replace(vehicle, rotors=rotors), interface="rotors", period=0.05, substeps=10)
    action = np.array([0.7, -0.6, 0.2, -0.1])
    hover, (low, high) = np.array(make_rigid_settings(simulation).rotors.hover), rotors.thrust
    wanted = np.where(action > 0.0, hover + action * (high - hover), hover + action * (hover - low))

    def rate(_: float, thrust: Floats) -> Floats:
        return np.asarray((wanted - thrust) / np.where(wanted > thrust, 0.03, 0.08))

    exact = solve_ivp(rate, (0.0, 0.05), hover, rtol=1e-10, atol=1e-12).y[:, -1]
    after = start(simulation, at_rest()).after(action)
    assert_allclose(after.memory[0, ROTOR_THRUST:], exact, rtol=1e-9)


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("name", [*PRESETS, "pivot beside the centre of mass"])
def test_a_zero_action_hovers_for_a_second(name: str, interface: str) -> None:
    vehicle = VEHICLES[name] if name in VEHICLES else random_vehicle(0, with_rotors=True)
    flight = start(Simulation(vehicle=vehicle, interface=interface), at_rest())
    for _ in range(100):
        flight = flight.after(np.zeros(4))
    assert_allclose(flight.state, at_rest(), rtol=0.0, atol=1e-9)


def rise_time(simulation: Simulation, axis: int) -> float:
    """Return the time after which a body rate has covered 63.2 % of a small step of the command, s."""
    action, limit = np.zeros(4), simulation.command_scale[1 + axis]
    action[1 + axis] = 1e-3
    flight, time, last = start(simulation, at_rest()), 0.0, 0.0
    while time < 10.0:
        flight, time = flight.after(action), time + simulation.period
        share = flight.memory[0, BODY_RATE + axis] / (1e-3 * limit)
        if share >= 1.0 - np.exp(-1.0):
            return float(time - simulation.period * (share - 1.0 + np.exp(-1.0)) / (share - last))
        last = share
    return np.inf


@pytest.mark.parametrize("step", [0.001, 0.002, 0.005])
@pytest.mark.parametrize("lag_ratio", [0.0, 0.1, 0.4, 1.0, 2.0])
def test_the_rate_loop_reaches_its_time_constant_whatever_the_lag(lag_ratio: float, step: float) -> None:
    vehicle = random_vehicle(3, with_rotors=True, pole=LIGHT, pivot=(0.0, 0.0, 0.0), rate_loop=RateLoop(0.05))
    vehicle = replace(vehicle, rotors=replace(rotors_of(vehicle), lag_up=0.05 * lag_ratio))
    simulation = Simulation(vehicle=vehicle, interface="body_rates", period=step, substeps=1)
    for axis in range(3):
        assert rise_time(simulation, axis) == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("name", PRESETS)
def test_the_rate_loop_of_a_preset_reaches_its_time_constant(name: str) -> None:
    """With its pole on its pivot."""
    simulation = Simulation(vehicle=name, interface="body_rates", period=0.002, substeps=1)
    for axis in range(3):
        assert rise_time(simulation, axis) == pytest.approx(VEHICLES[name].rate_loop.time_constant, rel=0.05)
