"""A tumbling quadrotor with its pendulum in MuJoCo, and how far the simulation of this package is from it.

The attitude model of this package (a constant inertia in the Euler angles) has no counterpart in MuJoCo. The quadrotor
is therefore a body in MuJoCo that does not turn, to which the same thrust is applied as a force in the world frame, and
only the translation and the pendulum are compared.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST, Disturbance, State
from quadpend_gym.vehicles import Parameters, Pole, Simulation, Vehicle
from tests.helpers.physics import random_commands, random_disturbances, random_states, simulate_period
from tests.helpers.rigid import start as start_flight
from tests.helpers.rigid_mujoco import Comparison, Engine

TIMESTEP = 1e-4  # s, of MuJoCo


def middle_thrusts(
    state: Floats, command: Floats, disturbance: Floats, parameters: Parameters, period: float
) -> Floats:
    """Return the thrust u R e₃ in the middle of each timestep of a control period, N, shape (steps, 3)."""
    s = State(state)
    time = (np.arange(round(period / TIMESTEP))[:, None] + 0.5) * TIMESTEP
    inertia = np.array([parameters.inertia_roll, parameters.inertia_pitch, parameters.inertia_yaw])
    euler_ddot = (command[COMMAND_TORQUE:] + Disturbance(disturbance).torque) / inertia
    euler = s.euler + s.euler_rate * time + 0.5 * euler_ddot * time**2
    return np.asarray(command[THRUST] * Rotation.from_euler("ZYX", euler[:, ::-1]).apply([0.0, 0.0, 1.0]))


def position_errors(
    parameters: Parameters, seed: int, duration: float, period: float, substeps: list[int]
) -> Comparison:
    """Compare the positions of both bodies in tumbling motion with MuJoCo's.

    Args:
        parameters: Parameters of the vehicle.
        seed: Seed of start, commands and disturbances, which are constant during a period.
        duration: Duration, s.
        period: Control period, s.
        substeps: Numbers of Runge–Kutta steps in a period.
    """
    p, periods = parameters, round(duration / period)
    start = random_states(1, seed)[0]
    states, largest = dict.fromkeys(substeps, start), dict.fromkeys(substeps, 0.0)
    commands, disturbances = random_commands(periods, seed, p), random_disturbances(periods, seed)
    level, inertia = start.copy(), (p.inertia_roll,) * 3  # any inertia, since nothing turns the body
    State(level).euler[:] = State(level).euler_rate[:] = 0.0
    body = Vehicle(p.quadrotor_mass, inertia, Pole(p.bob_mass, p.rod_length), torque=(1.0, 1.0), gravity=p.gravity)
    engine, rate = Engine(start_flight(Simulation(vehicle=body), level), TIMESTEP), 0.0
    for command, disturbance in zip(commands, disturbances, strict=True):
        load = Disturbance(np.append(disturbance[:6], np.zeros(3)))
        for thrust in middle_thrusts(states[substeps[0]], command, disturbance, p, period):
            load.force[:] = thrust + Disturbance(disturbance).force
            engine.advance(np.zeros(4), load.array, TIMESTEP)
            rate = max(rate, float(np.linalg.norm(engine.data.qvel[6:9])))  # of the pendulum, which does not spin
        positions = engine.positions()
        for number in substeps:
            states[number] = simulate_period(states[number], command, disturbance, p, period, number)[0]
            s = State(states[number])
            ours = np.array([s.position, s.position + p.rod_length * s.direction])
            largest[number] = max(largest[number], float(np.abs(ours - positions).max()))
    return Comparison(largest, rate)
