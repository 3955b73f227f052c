"""Random rigid vehicles with their states and inputs, and a simulation of them, for tests of the physics."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE, State
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

    def rates(self, action: Floats, disturbance: Floats) -> tuple[State, Floats]:
        """Return the rates of change of state and memory, as differences of order 4 over the first four periods."""
        flights = [self]
        for _ in range(4):
            flights.append(flights[-1].after(action, disturbance))
        weights = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / (12.0 * self.simulation.period)
        state, memory = (np.array([getattr(each, name) for each in flights]) for name in ("state", "memory"))
        return State(np.tensordot(weights, state, 1)), np.tensordot(weights, memory, 1)


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
