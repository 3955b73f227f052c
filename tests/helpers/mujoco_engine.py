"""A tumbling quadrotor with its pendulum in MuJoCo, and how far the simulation of this package is from it.

The attitude model of this package (a constant inertia in the Euler angles) has no counterpart in MuJoCo. The quadrotor
is therefore a point mass in MuJoCo, to which the same thrust is applied as a force in the world frame, and only the
translation and the pendulum are compared.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST, Disturbance, State
from quadpend_gym.vehicles import Parameters
from tests.helpers.physics import random_commands, random_disturbances, random_states, simulate_period

TIMESTEP = 1e-4  # s, of MuJoCo

# MuJoCo needs an inertia of the bob for a regular mass matrix; 1e-12 kg·m² is negligible beside m_c l² = 0.04 kg·m².
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -{p.gravity}" timestep="{timestep}" integrator="RK4">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="quadrotor">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="{p.quadrotor_mass}" diaginertia="1 1 1"/>
      <body name="pendulum">
        <joint type="ball"/>
        <inertial pos="0 0 {p.rod_length}" mass="{p.bob_mass}" diaginertia="1e-12 1e-12 1e-12"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Comparison(NamedTuple):
    """The distance of a flight from MuJoCo's.

    Attributes:
        errors: Largest distance of a body along an axis, m, by the number of substeps.
        rate: Largest rate of the flight, rad/s: of the pendulum and, for a rigid vehicle, of its body.
    """

    errors: dict[int, float]
    rate: float


class Engine:
    """MuJoCo simulation of the two bodies; the quadrotor is body 1, the bob body 2."""

    def __init__(self, state: Floats, parameters: Parameters) -> None:
        self.model = mujoco.MjModel.from_xml_string(MODEL.format(p=parameters, timestep=TIMESTEP))
        self.data = mujoco.MjData(self.model)
        s = State(state)
        rotation, _ = Rotation.align_vectors([s.direction], [[0.0, 0.0, 1.0]])
        spin = np.cross(s.direction, s.direction_rate)
        self.data.qpos[0:3], self.data.qvel[0:3] = s.position, s.velocity
        self.data.qpos[3:7] = rotation.as_quat(scalar_first=True)
        # MuJoCo expresses the angular velocity of a ball joint in the frame of the moving body.
        self.data.qvel[3:6] = rotation.inv().apply(spin)
        mujoco.mj_forward(self.model, self.data)

    def step(self, force: Floats, bob_force: Floats) -> None:
        """Advance by one timestep with constant forces in the world frame, N."""
        self.data.xfrc_applied[1, 0:3], self.data.xfrc_applied[2, 0:3] = force, bob_force
        mujoco.mj_step(self.model, self.data)

    def squared_rate(self) -> float:
        """Return |ṙ|², rad²/s²; the pendulum does not turn about its own axis."""
        spin = self.data.qvel[3:6]
        return float(spin @ spin)

    def positions(self) -> Floats:
        """Return the positions of quadrotor and bob, m, shape (2, 3)."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return np.array(self.data.xipos[1:3])


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
    engine, squared_rate = Engine(start, p), 0.0
    for command, disturbance in zip(commands, disturbances, strict=True):
        for thrust in middle_thrusts(states[substeps[0]], command, disturbance, p, period):
            engine.step(thrust + Disturbance(disturbance).force, Disturbance(disturbance).bob_force)
            squared_rate = max(squared_rate, engine.squared_rate())
        positions = engine.positions()
        for number in substeps:
            states[number] = simulate_period(states[number], command, disturbance, p, period, number)[0]
            s = State(states[number])
            ours = np.array([s.position, s.position + p.rod_length * s.direction])
            largest[number] = max(largest[number], float(np.abs(ours - positions).max()))
    return Comparison(largest, float(np.sqrt(squared_rate)))
