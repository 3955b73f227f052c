"""Energy and symmetries of rigid vehicles, and the order of the integrator."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST
from quadpend_gym.physics.state import State
from quadpend_gym.vehicles import Pole, Rotors, Simulation, Vehicle
from tests.helpers.controllers import rotate_states, rotate_vectors
from tests.helpers.physics import UNEQUAL, random_disturbances, random_states, simulate_period
from tests.helpers.rigid import SPINS, Flight, at_rest, random_vehicle, start, start_tumbling

NO_THRUST = np.array([-1.0, 0.0, 0.0, 0.0])
ROWS = 20
LIGHT = Pole(1e-5, 0.01)  # a pole that an attitude hardly notices, at the body's centre of mass


def energy(flight: Flight) -> Floats:
    """Return the kinetic plus potential energy of body and pole in J, shape (n,)."""
    v, s = flight.simulation.vehicle, flight.named
    velocity, rate = pole_velocity(flight), flight.body_rate
    height = v.mass * s.position[:, 2] + v.pole.mass * flight.pole_position[:, 2]
    return np.asarray(
        0.5 * v.mass * np.sum(s.velocity**2, -1)
        + 0.5 * v.pole.mass * np.sum(velocity**2, -1)
        + 0.5 * v.pole.inertia * np.sum(s.direction_rate**2, -1)
        + 0.5 * np.sum(rate * (rate @ v.inertia_matrix), -1)
        + v.gravity * height
    )


def pole_velocity(flight: Flight) -> Floats:
    """Return the velocity of the pole's centre of mass, m/s, world frame, shape (n, 3)."""
    v, s = flight.simulation.vehicle, flight.named
    return np.asarray(
        s.velocity + flight.attitude.apply(np.cross(flight.body_rate, v.pivot)) + v.pole.length * s.direction_rate
    )


def test_energy_is_conserved_without_inputs() -> None:
    vehicle = random_vehicle(0)
    flight = start_tumbling(Simulation(vehicle=vehicle, period=2.0, substeps=4000), ROWS, 0)
    x, y, _ = vehicle.pivot
    trim = vehicle.pole.mass * vehicle.gravity * np.array([y, -x])  # N·m at a zero action; it balances the pole
    nothing = np.array([-1.0, *(-trim / 10.0), 0.0])  # the torque limits are 10 N·m
    assert_allclose(energy(flight.after(nothing)), energy(flight), rtol=0.0, atol=1e-8)


def test_the_integrator_is_of_fourth_order() -> None:
    vehicle, disturbance = random_vehicle(2, with_rotors=True), random_disturbances(ROWS, 2)
    action = np.random.default_rng(2).uniform(-1.0, 1.0, (ROWS, 4))
    substeps = np.array([40, 80, 160, 320])

    def arrive(count: int) -> Floats:
        flight = start_tumbling(Simulation(vehicle=vehicle, interface="rotors", period=0.2, substeps=count), ROWS, 2)
        after = flight.after(action, disturbance)
        return np.column_stack([after.state[:, :6], after.state[:, 12:], after.memory])

    exact = arrive(3000)
    errors = [np.abs(arrive(int(count)) - exact) for count in substeps]
    # Position, velocity, direction, direction rate, quaternion and body rate.
    for first, last in ((0, 3), (3, 6), (6, 9), (9, 12), (12, 16), (16, 19)):
        largest = [error[:, first:last].max() for error in errors]
        slope = np.polyfit(np.log(0.2 / substeps), np.log(largest), 1)[0]
        assert slope == pytest.approx(4.0, abs=0.15)


@pytest.mark.parametrize("yaw", [0.3, -2.0])
def test_a_rotation_about_the_vertical_rotates_the_motion(yaw: float) -> None:
    vehicle = random_vehicle(3, with_rotors=True, drag={"area": 0.01, "rotor": (0.2, 0.3, 0.4), "angular": (0.01,) * 3})
    simulation = Simulation(vehicle=vehicle, interface="body_rates", period=0.3, substeps=30)
    action = np.random.default_rng(3).uniform(-1.0, 1.0, (ROWS, 4))
    here, disturbance = start_tumbling(simulation, ROWS, 3), random_disturbances(ROWS, 3)
    turned = rotate_vectors(disturbance.reshape(ROWS, 3, 3), yaw).reshape(ROWS, 9)
    there = start(simulation, rotate_states(here.state, yaw)).after(action, turned)
    after = here.after(action, disturbance)
    difference = there.state - rotate_states(after.state, yaw)
    difference[:, 6:9] -= 2.0 * np.pi * np.round(difference[:, 6:9] / (2.0 * np.pi))
    assert_allclose(np.delete(difference, range(9, 12), 1), 0.0, atol=1e-10)
    assert_allclose(there.memory[:, BODY_RATE:], after.memory[:, BODY_RATE:], rtol=0.0, atol=1e-10)


def test_propellers_turn_against_their_yaw_torque_and_make_a_spinning_body_precess() -> None:
    """For equal moments of inertia I, the body rate turns about e₃ at the rate h/I, since I ω + h e₃ stands still."""
    inertia, speed_squared = 0.01, 1e6  # kg·m², (rad/s)² per newton
    rotors = Rotors(
        ((0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (-0.2, 0.0, 0.0), (0.0, -0.2, 0.0)),
        SPINS,
        (0.5, 8.0),
        torque_per_thrust=1e-5,  # hardly any yaw torque
        inertia=1e-5,
        thrust_coefficient=1.0 / speed_squared,
    )
    vehicle = Vehicle(1.0, (inertia,) * 3, LIGHT, torque=(1.0, 1.0), rotors=rotors)
    simulation = Simulation(vehicle=vehicle, interface="rotors", period=0.5, substeps=500)
    flight = start(simulation, at_rest())
    flight.memory[:, BODY_RATE:ROTOR_THRUST] = 1.0, 0.0, 0.0
    after = flight.after(np.array([1.0, -1.0, 1.0, -1.0]))
    speeds = np.sqrt(speed_squared * after.memory[0, ROTOR_THRUST:])
    momentum = -rotors.inertia * float(np.array(SPINS) @ speeds)
    assert momentum < -0.04
    turn = momentum / inertia * 0.5
    assert_allclose(after.body_rate[0, :2], [np.cos(turn), np.sin(turn)], rtol=0.0, atol=1e-5)


def test_near_hover_a_rigid_body_moves_as_the_papers_model_to_second_order() -> None:
    p = UNEQUAL
    pole, inertia = Pole(p.bob_mass, p.rod_length), (p.inertia_roll, p.inertia_pitch, p.inertia_yaw)
    vehicle = Vehicle(p.quadrotor_mass, inertia, pole, torque=(5.0, 1.0), gravity=p.gravity)
    simulation = Simulation(vehicle=vehicle, period=0.4, substeps=200)
    rest, deviation = at_rest(ROWS), random_states(ROWS, 4)
    actions, disturbance = np.random.default_rng(4).uniform(-1.0, 1.0, (ROWS, 4)), random_disturbances(ROWS, 4)
    parameters = p._replace(quadrotor_drag_area=0.0, bob_drag_area=0.0)
    sizes, errors = np.array([0.004, 0.002, 0.001]), []
    for size in sizes:
        state = rest + size * deviation
        r, r_dot = State(state).direction, State(state).direction_rate
        r /= np.linalg.norm(r, axis=-1, keepdims=True)
        r_dot -= np.sum(r * r_dot, axis=-1, keepdims=True) * r
        rigid = start(simulation, state).after(size * actions, size * disturbance).state
        command = simulation.command_scale * (size * actions + [1.0, 0.0, 0.0, 0.0])
        euler = simulate_period(state, command, size * disturbance, parameters, 0.4, 200)
        errors.append(np.abs(rigid - euler).max(axis=0))
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slopes.min() >= 1.9
    assert slopes[9:11] == pytest.approx(2.0, abs=0.1)  # the rates of roll and pitch
