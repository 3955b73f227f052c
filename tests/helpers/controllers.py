"""What the tests of the controllers share: flat flights, laws that know everything, and worlds turned about z."""

from collections.abc import Callable
from typing import Any

import numpy as np

from quadpend_baselines.controllers.output_feedback import ControlLaw
from quadpend_baselines.estimation.estimator import Estimate, Measurement
from quadpend_baselines.modelling import flat_outputs
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import Parameters, Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import STATE_SIZE, State

CALM = np.zeros(9)
HOVER = Reference.hover()


def flat_state_and_command(
    reference: Reference, time: float, disturbance: Floats, p: Parameters
) -> tuple[Floats, Floats]:
    """State in the world, shape (1, 18), and command, shape (1, 4), of following `reference` exactly."""
    d, forces = reference.derivatives(np.array([time])), np.atleast_2d(disturbance)
    flight = flat_outputs.flat_trajectory(d[:, 2:, :3], forces, p)
    state, command = flat_outputs.state_and_command(flight, d[:, :3, 3], forces, p)
    State(state).position[:] += d[:, 0, :3]
    State(state).velocity[:] += d[:, 1, :3]
    return state, command


def measurement_of(state: Floats, reference: Reference = HOVER, time: float = 0.0) -> Measurement:
    """What there is to know of states in the world, shape (n, 18), beside a reference."""
    rows, d = len(state), reference.derivatives(time)
    beside = State(state.copy())
    beside.position[:] -= d[0, :3]
    beside.velocity[:] -= d[1, :3]
    return Measurement(beside.array, np.tile(d[2:, :3], (rows, 1, 1)), np.tile(d[:3, 3], (rows, 1)))


def true_estimate(measurement: Measurement, disturbance: Floats = CALM) -> Estimate:
    """An estimate that is the truth."""
    rows = len(measurement.state)
    forces = np.array(np.broadcast_to(disturbance, (rows, CALM.size)))
    return Estimate(measurement.state, forces, measurement.reference, np.zeros(rows, np.int64))


def simulate_with_true_state(
    law: ControlLaw,
    simulation: Simulation,
    state: Floats,
    steps: int,
    reference: Reference = HOVER,
    disturbance: Floats = CALM,
    watch: Callable[[Measurement, Floats, Any], None] = lambda measurement, command, memory: None,
) -> Floats:
    """The states, shape (n, 18), after `steps` periods under a law that is told state and wind.

    Commands keep to the actuators' limits. `watch` is shown each measurement with the command and memory it led to.
    """
    state, memory = np.array(np.atleast_2d(state), order="C"), law.initial_memory(len(np.atleast_2d(state)))
    physics = np.tile(simulation.parameters.as_array(), (len(state), 1))
    forces = np.array(np.broadcast_to(disturbance, (len(state), CALM.size)))
    for step in range(steps):
        measurement = measurement_of(state, reference, step * simulation.period)
        command, memory = law.command(true_estimate(measurement, disturbance), measurement, memory)
        _, command = to_action(command, simulation)
        watch(measurement, command, memory)
        advance(state, command, forces, physics, simulation.period, simulation.substeps)
    return state


def hover_states(rows: int = 1, height: float = 2.0) -> Floats:
    """Hover upright, shape (rows, 18)."""
    state = State(np.zeros((rows, STATE_SIZE)))
    state.direction[:, 2], state.position[:, 2] = 1.0, height
    return state.array


def tilted_pendulum(tilt: Any, azimuth: Any, rows: int = 1) -> Floats:
    """Hover at rest but for the pendulum's angles from upright (rad) and their azimuths (rad), shape (rows, 18)."""
    state = hover_states(rows)
    parts = np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)
    State(state).direction[:] = np.stack(np.broadcast_arrays(*parts), axis=-1)
    return state


def tracking_errors(measurement: Measurement, rod_length: float) -> Floats:
    """Distance of the flat outputs from the reference, m, shape (n,)."""
    state = State(measurement.state)
    return np.asarray(np.linalg.norm(state.position + rod_length * state.direction * [1.0, 1.0, 0.0], axis=1))


def rotate_vectors(vectors: Floats, angle: float) -> Floats:
    """World vectors, shape (..., 3), turned about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(vectors @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


def rotate_states(state: Floats, angle: float) -> Floats:
    """States, shape (..., 18), of a world turned about z."""
    out, s = State(state.copy()), State(state)
    for name in ("position", "velocity", "direction", "direction_rate"):
        getattr(out, name)[:] = rotate_vectors(getattr(s, name), angle)
    out.euler[..., 2] += angle
    return out.array
