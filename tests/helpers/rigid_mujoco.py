"""Rigid vehicles with their pole in MuJoCo, and how far the simulation of this package is from it.

MuJoCo gets the body with its full inertia, the pole with its inertia on a ball joint beside the centre of mass, and
either a thrust and torques in the body frame or four rotors with their places, yaw torques and lag. It has no drag, no
propeller inertia and one time constant of a rotor.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import make_rigid_settings
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.vehicles import Simulation, Vehicle
from tests.helpers.physics import random_disturbances
from tests.helpers.rigid import Flight, start_tumbling

# MuJoCo needs an inertia of the pole; beside m l² of the whole pole that of a point mass is negligible, and with zero
# spin that about its axis has no effect.
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
        <inertial pos="0 0 {v.pole.length}" mass="{v.pole.mass}" diaginertia="{transverse} {transverse} {axial}"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
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
        transverse=max(vehicle.pole.inertia, 1e-12),
        axial=min(max(vehicle.pole.inertia, 1e-12), 1e-9),
        actuators="".join(f'<general site="s{n}" gear="{gear}" {lag}/>' for n, gear in enumerate(gears)),
    )


class Engine:
    """MuJoCo simulation of both bodies; the quadrotor is body 1, the pole body 2."""

    def __init__(self, flight: Flight, timestep: float) -> None:
        self.vehicle = flight.simulation.vehicle
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

    def advance(self, command: Floats, disturbance: Floats, period: float) -> None:
        """Advance by `period` seconds under thrust and torques, or four thrusts, and forces in the world frame."""
        d, data = Disturbance(disturbance), self.data
        data.ctrl[:] = command
        data.xfrc_applied[1, 0:3], data.xfrc_applied[1, 3:6], data.xfrc_applied[2, 0:3] = d.force, d.torque, d.bob_force
        mujoco.mj_step(self.model, data, round(period / self.model.opt.timestep))

    def positions(self) -> Floats:
        """Return the positions of the centres of mass of both bodies, m, shape (2, 3)."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return np.array(self.data.xipos[1:3])


def command_of(action: Floats, simulation: Simulation) -> Floats:
    """Return thrust and torques (N, N·m), or the thrusts of the rotors (N), that an action commands."""
    vehicle = simulation.vehicle
    if vehicle.rotors is None:
        x, y, _ = vehicle.pivot
        weight = vehicle.pole.mass * vehicle.gravity
        trim = np.array([0.0, y * weight, -x * weight, 0.0])  # balances the pole beside the centre of mass
        scale = simulation.command_scale
        return np.asarray(scale * (action + np.array([1.0, 0.0, 0.0, 0.0])) + trim)
    low, high = vehicle.rotors.thrust
    hover = np.array(make_rigid_settings(simulation).rotors.hover)
    return np.asarray(np.where(action > 0.0, hover + action * (high - hover), hover + action * (hover - low)))


def rigid_position_errors(
    vehicle: Vehicle,
    seed: int,
    duration: float,
    period: float,
    substeps: list[int],
    timestep: float,
    forces: Floats,
) -> Comparison:
    """Compare the positions of body and pole with MuJoCo's in a tumbling flight with random inputs.

    Args:
        vehicle: The vehicle, with rotors and without drag.
        seed: Seed of start, actions and disturbances, which are constant during a period.
        duration: Duration, s.
        period: Control period, s.
        substeps: Numbers of Runge–Kutta steps in a period.
        timestep: Step of MuJoCo, s.
        forces: Standard deviations of the disturbances, N and N·m, shape (9,).
    """
    simulations = {n: Simulation(vehicle=vehicle, interface="rotors", period=period, substeps=n) for n in substeps}
    flights = {number: start_tumbling(simulation, 1, seed) for number, simulation in simulations.items()}
    simulation, rng = simulations[substeps[0]], np.random.default_rng([5, seed])
    engine, rate = Engine(flights[substeps[0]], timestep), 0.0
    largest = dict.fromkeys(substeps, 0.0)
    for disturbance in random_disturbances(round(duration / period), seed):
        action = rng.uniform(-1.0, 1.0, 4)
        action[1:] *= 0.3
        disturbance *= forces
        engine.advance(command_of(action, simulation), disturbance, period)
        for number in substeps:
            flights[number] = flight = flights[number].after(action, disturbance)
            ours = np.concatenate([flight.named.position, flight.pole_position])
            largest[number] = max(largest[number], float(np.abs(ours - engine.positions()).max()))
        last = flights[substeps[-1]]
        rate = max(rate, *np.linalg.norm([last.named.direction_rate[0], last.body_rate[0]], axis=-1).tolist())
    return Comparison(largest, rate)
