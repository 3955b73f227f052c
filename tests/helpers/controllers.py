"""Helpers of the controllers' tests: exact trajectories, simulation with true states, and rotated worlds."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines import controller
from quadpend_baselines.controllers.law import Law
from quadpend_baselines.estimation.estimate import LOOP, Estimate
from quadpend_baselines.gains import tuning
from quadpend_baselines.hybrid import Hybrid
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.policy.protocol import episode_start_mask, to_action
from quadpend_baselines.registry import controller_of
from quadpend_gym import Parameters, Reference, Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.euler_kernel import advance
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, Disturbance, State
from quadpend_gym.vehicles import Pole, Vehicle

CALM = np.zeros(DISTURBANCE_SIZE)
HOVER = Reference.hover()
Callback = Callable[[Estimate, Floats, Any], None]


def simulation_of(p: Parameters, torque: tuple[float, float] = (5.0, 1.0), **options: Any) -> Simulation:
    """Return the simulation of a vehicle with the paper's attitude model, given parameters and torque limits."""
    inertia, pole = (p.inertia_roll, p.inertia_pitch, p.inertia_yaw), Pole(p.bob_mass, p.rod_length)
    vehicle = Vehicle(mass=p.quadrotor_mass, inertia=inertia, pole=pole, attitude="euler", torque=torque)
    return Simulation(vehicle=replace(vehicle, gravity=p.gravity), **options)


def quick_controller(name: str) -> Any:
    """Return the controller with a name; nmpc with a short horizon, so that tests of many steps are fast."""
    if name != "nmpc":
        return controller(name)
    return controller_of(name, replace(tuning(name).gains, periods=2, period=0.08), None)


def disturbance_of(
    force: Any = (0.0, 0.0, 0.0), bob_force: Any = (0.0, 0.0, 0.0), torque: Any = (0.0, 0.0, 0.0)
) -> Floats:
    """Return a disturbance, shape (9,), from its forces (N) and torques (N·m)."""
    out = Disturbance(np.zeros(DISTURBANCE_SIZE))
    out.force[:], out.bob_force[:], out.torque[:] = force, bob_force, torque
    return out.array


def flat_state_and_command(
    reference: Reference, time: float, disturbance: Floats, p: Parameters
) -> tuple[Floats, Floats]:
    """Return the state in the world frame, shape (1, 18), and the command, shape (1, 4), that follow a reference."""
    d, disturbance = reference.derivatives(np.array([time])), np.atleast_2d(disturbance)
    state, command = equivalent_model(simulation_of(p)).trajectory(d[:, 2:, :3], d[:, :3, 3], disturbance)
    State(state).position[:] += d[:, 0, :3]
    State(state).velocity[:] += d[:, 1, :3]
    return state, command


def measurement_of(state: Floats, reference: Reference = HOVER, time: float = 0.0) -> Estimate:
    """Return the exact measurement of states in the world frame, shape (n, 18)."""
    rows, d = len(state), reference.derivatives(time)
    relative = State(state.copy())
    relative.position[:] -= d[0, :3]
    relative.velocity[:] -= d[1, :3]
    out = Estimate(np.zeros((rows, LOOP)))
    out.state[:], out.reference[:], out.yaw[:] = relative.array, d[2:, :3], d[:3, 3]
    return out


def true_estimate(measurement: Estimate, disturbance: Floats = CALM) -> Estimate:
    """Return the estimate without error."""
    out = Estimate(measurement.array.copy())
    out.disturbance[:], out.mass_ratio[:] = disturbance, 1.0
    return out


def run_law(law: Any, state: Floats, memory: Any = None, wind: Floats = CALM, reference: Reference = HOVER) -> Any:
    """Return command and memory of a control law that receives true states, shape (n, 18), and the true wind."""
    measurement = measurement_of(state, reference)
    memory = law.initial_memory(len(state)) if memory is None else memory
    return law.command(true_estimate(measurement, wind), memory)


def simulate_with_true_state(
    law: Law,
    simulation: Simulation,
    state: Floats,
    steps: int,
    reference: Reference = HOVER,
    disturbance: Floats = CALM,
    callback: Callback = lambda measurement, command, memory: None,
) -> Floats:
    """Simulate a control law that receives the true state and disturbance.

    Args:
        law: The control law; its commands saturate at the limits of the actuators.
        simulation: The plant.
        state: Initial states in the world frame, shape (18,) or (n, 18).
        steps: Number of control periods.
        reference: The reference to track.
        disturbance: Constant disturbance, N and N·m, shape (9,).
        callback: Called in every period with the measurement, the saturated command and the memory of the law.

    Returns:
        The final states, shape (n, 18).
    """
    state = np.array(np.atleast_2d(state), order="C")
    memory = law.initial_memory(len(state))
    parameters = np.tile(simulation.parameters.as_array(), (len(state), 1))
    disturbances = np.array(np.broadcast_to(disturbance, (len(state), CALM.size)), order="C")
    for step in range(steps):
        measurement = measurement_of(state, reference, step * simulation.period)
        command, memory = law.command(true_estimate(measurement, disturbance), memory)
        command = plant_of(simulation).command(to_action(command, simulation))
        callback(measurement, command, memory)
        advance(state, command, disturbances, parameters, simulation.period, simulation.substeps)
    return state


def hover_states(rows: int = 1, height: float = 2.0) -> Floats:
    """Return states at rest with the pendulum upright, shape (rows, 18)."""
    state = State(np.zeros((rows, STATE_SIZE)))
    state.direction[:, 2], state.position[:, 2] = 1.0, height
    return state.array


def tilted_pendulum(tilt: Any, azimuth: Any, rows: int = 1) -> Floats:
    """Return states at rest with a tilted pendulum, shape (rows, 18); `tilt` and `azimuth` in rad."""
    state = hover_states(rows)
    parts = np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)
    State(state).direction[:] = np.stack(np.broadcast_arrays(*parts), axis=-1)
    return state


def tracking_distance(measurement: Estimate, rod_length: float) -> Floats:
    """Return the distance of the flat outputs from the reference, m, shape (n,)."""
    state = State(measurement.state)
    return np.asarray(np.linalg.norm(state.position + rod_length * state.direction * [1.0, 1.0, 0.0], axis=1))


def rotate_vectors(vectors: Floats, angle: float) -> Floats:
    """Rotate world vectors, shape (..., 3), about z by `angle` (rad)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(vectors @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


def rotate_states(state: Floats, angle: float) -> Floats:
    """Rotate states, shape (..., 18), about z by `angle` (rad), the heading included."""
    out, s = State(state.copy()), State(state)
    for name in ("position", "velocity", "direction", "direction_rate"):
        getattr(out, name)[:] = rotate_vectors(getattr(s, name), angle)
    out.euler[..., 2] += angle
    return out.array


Agent = Callable[[Floats32], Floats32]


def constant(*action: float) -> Agent:
    """An agent that always outputs `action`."""
    return lambda seen: np.tile(np.float32(action), (len(seen), 1))


class HybridPolicy:
    """A hybrid and its agent as one policy with the `predict` protocol."""

    def __init__(self, hybrid: Hybrid, agent: Agent) -> None:
        self.hybrid, self.agent = hybrid, agent

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        started = episode_start_mask(episode_start, state is None, len(observation))
        seen, memory = self.hybrid.observe(observation, state, started)
        return self.hybrid.act(self.agent(seen), memory)


def run_policy(policy: Any, env: VectorEnv[Any, Any, Any], steps: int, **reset: Any) -> tuple[list[Any], list[Any]]:
    """Actions of a policy and the results of `env.step`, across same-step autoresets."""
    observation, _ = env.reset(seed=5, **reset)
    memory, started = None, np.ones(env.num_envs, np.bool_)
    actions, results = [], []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, started)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        actions.append(action)
        results.append((observation, reward, terminated, truncated, info))
    return actions, results
