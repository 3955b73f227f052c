"""Random states and inputs for tests of the physics, and a simulation of one period."""

import numpy as np

from quadpend_gym import PAPER, Parameters
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_SIZE, STATE_SIZE, THRUST, State

# All values are different, so that swapped parameters change the result.
UNEQUAL = PAPER._replace(
    quadrotor_mass=0.7, bob_mass=0.25, rod_length=0.4, inertia_roll=0.08, inertia_pitch=0.11, inertia_yaw=0.17
)


def random_states(rows: int, seed: int, spread: float = 1.0) -> Floats:
    """Draw tumbling states, shape (rows, 18); `spread` scales all but the direction of the pendulum."""
    rng = np.random.default_rng([0, seed])
    state = State(spread * rng.normal(size=(rows, STATE_SIZE)))
    direction = rng.normal(size=(rows, 3))
    state.direction[:] = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    # The cross product makes ṙ perpendicular to r.
    state.direction_rate[:] = 3.0 * np.cross(state.direction_rate, state.direction)
    return state.array


def random_commands(rows: int, seed: int, parameters: Parameters) -> Floats:
    """Draw thrusts from zero to twice the weight (N) and torques up to ±1 N·m, shape (rows, 4)."""
    command = np.random.default_rng([1, seed]).uniform(-1.0, 1.0, (rows, COMMAND_SIZE))
    command[:, THRUST] = parameters.hover_thrust * (1.0 + command[:, THRUST])
    return command


def random_disturbances(rows: int, seed: int) -> Floats:
    """Draw forces on both bodies (N) and torques (N·m) of order one, shape (rows, 9)."""
    return np.random.default_rng([2, seed]).normal(size=(rows, DISTURBANCE_SIZE))


def simulate_period(
    state: Floats, command: Floats, disturbance: Floats, parameters: Parameters, period: float, substeps: int
) -> Floats:
    """Return the states after `period` seconds with constant inputs, shape (rows, 18)."""
    state = np.array(np.atleast_2d(state), order="C")
    rows = state.shape[0]
    command, disturbance, physics = (
        np.array(np.broadcast_to(array, (rows, array.shape[-1])), order="C")
        for array in (command, disturbance, parameters.as_array())
    )
    advance(state, command, disturbance, physics, period, substeps)
    return state


def rates(state: Floats, command: Floats, disturbance: Floats, parameters: Parameters) -> State:
    """Return the rates of change of states under the kernel, as central differences of order 4, shape (rows, 18)."""
    step, inputs = 5e-4, (command, disturbance, parameters)  # s
    one, two = (
        simulate_period(state, *inputs, length, 1) - simulate_period(state, *inputs, -length, 1)
        for length in (step, 2.0 * step)
    )
    return State((8.0 * one - two) / (12.0 * step))


def state_from_coordinates(q: Floats, q_dot: Floats) -> Floats:
    """Convert position, Euler angles and the pole's (α, β), and their rates, to a state array of shape (18,)."""
    sa, ca, sb, cb = np.sin(q[6]), np.cos(q[6]), np.sin(q[7]), np.cos(q[7])
    tangents = np.array([[ca * cb, -sa * sb], [ca * sb, sa * cb], [-sa, 0.0]])
    parts: list[Floats] = [q[:3], q_dot[:3], q[3:6], q_dot[3:6], np.array([sa * cb, sa * sb, ca]), tangents @ q_dot[6:]]
    return np.concatenate(parts)
