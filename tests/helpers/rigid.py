"""Random rigid vehicles with their states and inputs, and a simulation of them, for tests of the physics."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.attitude import Quaternion
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_body import Loads, Motion, Wrench, derivative, rigid_physics
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.rigid_settings import pack_rigid, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.physics.vectors import axpy, load, scale, store
from quadpend_gym.vehicles import Pole, RateLoop, Rotors, Simulation, Vehicle
from tests.helpers.physics import random_states

SPINS: Any = (1, -1, 1, -1)


def random_inertia(rng: np.random.Generator, mass: float) -> tuple[tuple[float, ...], ...]:
    """Draw the inertia of a body with radii of gyration of some centimetres about random axes, kg·m²."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    second = axes @ np.diag(mass * rng.uniform(0.03, 0.15, 3) ** 2) @ axes.T
    inertia = np.trace(second) * np.eye(3) - second
    return tuple(tuple(row) for row in (0.5 * (inertia + inertia.T)).tolist())


def random_rotors(rng: np.random.Generator, weight: float) -> Rotors:
    """Draw four rotors near the corners of a square; together they carry 2.5 times the weight (N) of the vehicle."""
    corners = 0.2 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    positions = np.column_stack([corners + rng.uniform(-0.03, 0.03, (4, 2)), rng.uniform(-0.05, 0.05, 4)])
    lag = float(rng.uniform(0.02, 0.1))
    places: Any = tuple(map(tuple, positions.tolist()))
    return Rotors(places, SPINS, (0.02 * weight, 0.625 * weight), 0.02, lag)


def random_vehicle(seed: int, with_rotors: bool = False, **fields: Any) -> Vehicle:
    """Draw a rigid vehicle with products of inertia, a pivot anywhere in the body and a pole with inertia."""
    rng = np.random.default_rng([4, seed])
    mass, pole_mass, length = rng.uniform(0.3, 1.5), rng.uniform(0.05, 0.5), rng.uniform(0.2, 0.8)
    pole = Pole(pole_mass, length, rng.uniform(0.0, 0.5) * pole_mass * length**2)
    given = {
        "inertia": random_inertia(rng, mass),
        "pole": pole,
        "pivot": tuple(rng.uniform(-0.08, 0.08, 3).tolist()),
        "rotors": random_rotors(rng, 9.81 * (mass + pole_mass)) if with_rotors else None,
        "torque": (10.0, 10.0),
        "rate_loop": RateLoop(0.1),
    }
    return Vehicle(float(mass), **{**given, **fields})


def rotors_of(vehicle: Vehicle) -> Rotors:
    """Return the rotors of a vehicle that has some."""
    assert vehicle.rotors is not None
    return vehicle.rotors


@dataclass(frozen=True)
class Flight:
    """A vehicle in motion: state (n, 18) and memory (n, 11), see `plants`; `simulation` names the vehicle."""

    simulation: Simulation
    state: Floats
    memory: Floats

    @property
    def named(self) -> State:
        """Named views of the state."""
        return State(self.state)

    @property
    def attitude(self) -> Rotation:
        """The rotation from the body to the world frame."""
        return Rotation.from_quat(self.memory[:, QUATERNION:BODY_RATE], scalar_first=True)

    @property
    def body_rate(self) -> Floats:
        """ω in the body frame, rad/s, shape (n, 3)."""
        return self.memory[:, BODY_RATE:ROTOR_THRUST]

    @property
    def pole_position(self) -> Floats:
        """Centre of mass of the pole, m, world frame, shape (n, 3)."""
        vehicle = self.simulation.vehicle
        pivot = self.named.position + self.attitude.apply(vehicle.pivot)
        return np.asarray(pivot + vehicle.pole.length * self.named.direction)

    def after(self, action: Floats, disturbance: Floats | None = None, **arguments: Any) -> "Flight":
        """Return the flight one control period later; action (4,) or (n, 4), disturbance (9,) or (n, 9)."""
        state, memory, rows = self.state.copy(), self.memory.copy(), len(self.state)
        disturbance = np.zeros(DISTURBANCE_SIZE) if disturbance is None else disturbance
        action, disturbance, parameters = (
            np.array(np.broadcast_to(array, (rows, size)), np.float64, order="C")
            for array, size in (
                (action, ACTION_SIZE),
                (disturbance, DISTURBANCE_SIZE),
                (self.simulation.parameters.as_array(), 9),
            )
        )
        plant_of(self.simulation).advance(state, memory, action, disturbance, parameters, **arguments)
        return Flight(self.simulation, state, memory)


def start(simulation: Simulation, state: Floats) -> Flight:
    """Return the start of a flight in states of shape (n, 18), with the rotor thrusts of hover."""
    state = np.array(np.atleast_2d(state), order="C")
    return Flight(simulation, state, rigid_from_state(state, simulation))


def start_tumbling(simulation: Simulation, rows: int, seed: int, spread: float = 1.0) -> Flight:
    """Return the start of flights in random tumbling states."""
    return start(simulation, random_states(rows, seed, spread))


def at_rest(rows: int = 1) -> Floats:
    """Return states of rest with an upright pole, shape (rows, 18)."""
    state = np.zeros((rows, STATE_SIZE))
    State(state).direction[:, 2] = 1.0
    return state


@compiled
def _derivative(numbers: Floats, packed: Floats, motion: Floats, inputs: Floats, out: Floats) -> None:
    rigid, physics = unpack_rigid(packed), load_physics(numbers.reshape((-1, 1)), 0)
    body = rigid_physics(physics, rigid.correlation, rigid.pivot, rigid.shape)
    fields = motion.reshape((-1, 1))
    q = Quaternion(motion[0], motion[1], motion[2], motion[3])
    start = Motion(q, load(fields, 4, 0), load(fields, 7, 0), load(fields, 10, 0))
    given = inputs.reshape((-1, 1))
    force, bob_force = load(given, 4, 0), load(given, 7, 0)
    relative = axpy(1.0 / physics.quadrotor_mass, force, scale(-1.0 / physics.bob_mass, bob_force))
    loads = Loads(force, bob_force, relative, load(given, 10, 0), inputs[13], rigid.angular_drag)
    result = derivative(start, Wrench(inputs[0], load(given, 1, 0)), loads, physics, body)
    store(out, 0, 0, result.centre)
    store(out, 3, 0, result.motion.rate)
    store(out, 6, 0, result.motion.direction_rate)


def accelerations(flight: Flight, wrench: Floats, disturbance: Floats, momentum: float) -> dict[str, Floats]:
    """Return ζ̈ (m/s²), ω̇ (rad/s²) and r̈ (1/s²) of the first row, each of shape (3,).

    Args:
        flight: The vehicle and its state.
        wrench: Thrust (N) and torques (N·m) of the rotors, shape (4,).
        disturbance: Forces (N) and torque (N·m) in the world frame, shape (9,).
        momentum: Angular momentum of the propellers, N·m·s.
    """
    s, simulation = flight.named, flight.simulation
    vehicle, p = simulation.vehicle, simulation.parameters
    motion = np.concatenate([flight.memory[0, :ROTOR_THRUST], s.direction[0], s.direction_rate[0]])
    inputs, out = np.concatenate([wrench, disturbance, [momentum]]), np.empty((9, 1))
    _derivative(p.as_array(), pack_rigid(simulation), motion, inputs, out)
    centre, rate_dot, direction_ddot = out.reshape(3, 3)
    rate, pivot = flight.body_rate[0], np.array(vehicle.pivot)
    pivot_ddot = flight.attitude[0].apply(np.cross(rate_dot, pivot) + np.cross(rate, np.cross(rate, pivot)))
    share = p.bob_mass / p.total_mass
    position_ddot = centre - share * (pivot_ddot + p.rod_length * direction_ddot)
    return {"position": position_ddot, "body_rate": rate_dot, "direction": direction_ddot}
