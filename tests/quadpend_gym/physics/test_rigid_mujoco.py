"""The simulation of tumbling rigid vehicles agrees with MuJoCo, an independent rigid-body engine.

MuJoCo gets the body with its full inertia, the pole with its inertia on a ball joint beside the centre of mass, and
either a thrust and torques in the body frame or four rotors with their places, yaw torques and lag.
"""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import hover_thrusts_of
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.vehicles import Vehicle
from tests.helpers.physics import random_disturbances
from tests.helpers.rigid import Flight, random_vehicle, start_tumbling

DURATION, PERIOD = 2.0, 0.1  # s

# MuJoCo needs an inertia of the pole about its axis; with zero spin it has no effect.
MODEL = """
<mujoco>
  <compiler angle="radian" inertiafromgeom="false" balanceinertia="false" boundmass="0" boundinertia="0"/>
  <option gravity="0 0 -{v.gravity}" timestep="{timestep}" integrator="RK4">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="quadrotor">
      <freejoint/>
      <inertial pos="0 0 0" mass="{v.mass}" fullinertia="{inertia}"/>
      {sites}
      <body name="pole" pos="{pivot}">
        <joint type="ball"/>
        <inertial pos="0 0 {v.pole.length}" mass="{v.pole.mass}" diaginertia="{transverse} {transverse} 1e-9"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""


def describe(vehicle: Vehicle, timestep: float) -> str:
    """Return the MuJoCo model of a vehicle, integrated with this step (s)."""
    i = vehicle.inertia_matrix
    if vehicle.rotors is None:
        places, gears = [(0.0, 0.0, 0.0)] * 4, ["0 0 1 0 0 0", "0 0 0 1 0 0", "0 0 0 0 1 0", "0 0 0 0 0 1"]
        lag = ""
    else:
        rotors = vehicle.rotors
        places = list(rotors.positions)
        gears = [f"0 0 1 0 0 {spin * rotors.torque_per_thrust!r}" for spin in rotors.spins]
        lag = f'dyntype="filter" dynprm="{rotors.lag_up!r}"'
    sites = "".join(f'<site name="s{n}" pos="{x!r} {y!r} {z!r}"/>' for n, (x, y, z) in enumerate(places))
    return MODEL.format(
        v=vehicle,
        timestep=timestep,
        inertia=" ".join(repr(float(i[entry])) for entry in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
        sites=sites,
        pivot=" ".join(map(repr, vehicle.pivot)),
        transverse=max(vehicle.pole.inertia, 1e-9),
        actuators="".join(f'<general site="s{n}" gear="{gear}" {lag}/>' for n, gear in enumerate(gears)),
    )


class Engine:
    """MuJoCo simulation of both bodies; the quadrotor is body 1, the pole body 2."""

    def __init__(self, flight: Flight, timestep: float) -> None:
        self.vehicle = flight.simulation.rigid_vehicle
        self.model = mujoco.MjModel.from_xml_string(describe(self.vehicle, timestep))
        self.data = mujoco.MjData(self.model)
        s, memory, data = flight.named, flight.memory[0], self.data
        r = s.direction[0]
        attitude = Rotation.from_quat(memory[QUATERNION:BODY_RATE], scalar_first=True)
        pole, _ = Rotation.align_vectors([r], [[0.0, 0.0, 1.0]])
        spin = np.cross(r, s.direction_rate[0])
        data.qpos[0:3], data.qvel[0:3] = s.position[0], s.velocity[0]
        data.qpos[3:7], data.qvel[3:6] = memory[QUATERNION:BODY_RATE], memory[BODY_RATE:ROTOR_THRUST]
        # A ball joint has the attitude relative to the body, and the relative rate in the frame of the pole.
        data.qpos[7:11] = (attitude.inv() * pole).as_quat(scalar_first=True)
        data.qvel[6:9] = pole.inv().apply(spin - attitude.apply(memory[BODY_RATE:ROTOR_THRUST]))
        if self.vehicle.rotors is not None:
            data.act[:] = memory[ROTOR_THRUST:]
        mujoco.mj_forward(self.model, data)

    def advance(self, command: Floats, disturbance: Floats) -> None:
        """Advance by one period under a command (thrust and torques, or four thrusts) and forces in the world frame."""
        d, data = Disturbance(disturbance), self.data
        data.ctrl[:] = command
        data.xfrc_applied[1, 0:3], data.xfrc_applied[1, 3:6], data.xfrc_applied[2, 0:3] = d.force, d.torque, d.bob_force
        mujoco.mj_step(self.model, data, round(PERIOD / self.model.opt.timestep))

    def positions(self) -> Floats:
        """Return the positions of the centres of mass of both bodies, m, shape (2, 3)."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return np.array(self.data.xipos[1:3])


def command_of(action: Floats, simulation: Simulation) -> Floats:
    """Return thrust and torques (N, N·m), or the thrusts of the rotors (N), that an action commands."""
    vehicle = simulation.rigid_vehicle
    if vehicle.rotors is None:
        x, y, _ = vehicle.pivot
        weight = vehicle.pole.mass * vehicle.gravity
        trim = np.array([0.0, y * weight, -x * weight, 0.0])  # balances the pole beside the centre of mass
        scale = simulation.command_scale
        return np.asarray(scale * (action + np.array([1.0, 0.0, 0.0, 0.0])) + trim)
    low, high = vehicle.rotors.thrust
    hover = hover_thrusts_of(simulation)
    return np.asarray(np.where(action > 0.0, hover + action * (high - hover), hover + action * (hover - low)))


def largest_difference(seed: int, with_rotors: bool, step: float) -> float:
    """Return the largest difference of a position in a tumbling flight of 2 s with random inputs, m.

    `step` is the step of both integrators, s.
    """
    vehicle, interface = random_vehicle(seed, with_rotors), "rotors" if with_rotors else "wrench"
    simulation = Simulation(vehicle=vehicle, interface=interface, period=PERIOD, substeps=round(PERIOD / step))
    periods, rng = round(DURATION / PERIOD), np.random.default_rng([5, seed])
    flight = start_tumbling(simulation, 1, seed)
    engine, largest = Engine(flight, step), 0.0
    for disturbance in random_disturbances(periods, seed):
        action = rng.uniform(-1.0, 1.0, 4)
        action[1:] *= 0.3 if with_rotors else 0.03
        disturbance[6:] *= 0.1
        flight = flight.after(action, disturbance)
        engine.advance(command_of(action, simulation), disturbance)
        ours = np.concatenate([flight.named.position, flight.pole_position])
        largest = max(largest, float(np.abs(ours - engine.positions()).max()))
    return largest


@pytest.mark.parametrize("with_rotors", [False, True], ids=["wrench", "rotors"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tumbling_rigid_vehicles_agree_with_mujoco(seed: int, with_rotors: bool) -> None:
    assert largest_difference(seed, with_rotors, 5e-4) <= 1e-6


if __name__ == "__main__":  # python -m tests.quadpend_gym.physics.test_rigid_mujoco
    for kind in (False, True):
        differences = [largest_difference(seed, kind, 2e-4) for seed in range(100)]
        name = "rotors" if kind else "wrench"
        print(
            f"{name}: 100 vehicles, largest difference {max(differences):.2g} m, median {np.median(differences):.2g} m"
        )
