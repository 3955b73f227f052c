"""Energy and momentum of the paper's vehicle."""

import numpy as np

from quadpend_gym import Parameters, State
from quadpend_gym.core.arrays import Floats


def energy(state: Floats, parameters: Parameters) -> Floats:
    """Return the kinetic plus potential energy in J, equations (2)–(5) of the paper, shape (...)."""
    s, p = State(state), parameters
    bob_velocity = s.velocity + p.rod_length * s.direction_rate
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    kinetic = (
        p.quadrotor_mass * np.sum(s.velocity**2, -1)
        + p.bob_mass * np.sum(bob_velocity**2, -1)
        + np.sum(inertia * s.euler_rate**2, -1)
    ) / 2
    bob_height = s.position[..., 2] + p.rod_length * s.direction[..., 2]
    return np.asarray(kinetic + p.gravity * (p.quadrotor_mass * s.position[..., 2] + p.bob_mass * bob_height))


def momentum(state: Floats, parameters: Parameters) -> Floats:
    """Return the linear momentum of both bodies in kg·m/s, world frame, shape (..., 3)."""
    s, p = State(state), parameters
    return np.asarray(p.total_mass * s.velocity + p.bob_mass * p.rod_length * s.direction_rate)
