"""The simulation of a tumbling quadrotor agrees with MuJoCo, an independent rigid-body engine.

The attitude model of this package (a constant inertia in the Euler angles) has no counterpart in MuJoCo. The test
therefore models the quadrotor as a point mass in MuJoCo, applies the same thrust as a force in the world frame, and
compares the translation and the pendulum only.
"""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.parameters import CONTROL_PERIOD, Parameters, Simulation
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST, Disturbance, State
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances, random_states, simulate_period

DURATION, TIMESTEP = 2.0, 1e-4  # s

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

    def positions(self) -> Floats:
        """Return the positions of quadrotor and bob, m, shape (2, 3)."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return np.array(self.data.xipos[1:3])


def middle_thrusts(state: Floats, command: Floats, disturbance: Floats, parameters: Parameters) -> Floats:
    """Return the thrust u R e₃ in the middle of each timestep of a control period, N, shape (steps, 3)."""
    s = State(state)
    time = (np.arange(round(CONTROL_PERIOD / TIMESTEP))[:, None] + 0.5) * TIMESTEP
    inertia = np.array([parameters.inertia_roll, parameters.inertia_pitch, parameters.inertia_yaw])
    euler_ddot = (command[COMMAND_TORQUE:] + Disturbance(disturbance).torque) / inertia
    euler = s.euler + s.euler_rate * time + 0.5 * euler_ddot * time**2
    return np.asarray(command[THRUST] * Rotation.from_euler("ZYX", euler[:, ::-1]).apply([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tumbling_motion_agrees_with_mujoco(seed: int) -> None:
    p = UNEQUAL
    periods = round(DURATION / CONTROL_PERIOD)
    state = random_states(1, seed)[0]
    commands, disturbances = random_commands(periods, seed, p), random_disturbances(periods, seed)
    engine = Engine(state, p)
    largest = 0.0
    for command, disturbance in zip(commands, disturbances, strict=True):
        for thrust in middle_thrusts(state, command, disturbance, p):
            engine.step(thrust + Disturbance(disturbance).force, Disturbance(disturbance).bob_force)
        state = simulate_period(state, command, disturbance, p, CONTROL_PERIOD, Simulation().substeps)[0]
        s = State(state)
        ours = np.array([s.position, s.position + p.rod_length * s.direction])
        largest = max(largest, np.abs(ours - engine.positions()).max())
    assert largest <= 1e-5
