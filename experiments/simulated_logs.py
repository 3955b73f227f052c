"""A log of the simulator's own: a vehicle without a pole flies the manoeuvre for identification.

The manoeuvre lasts 60 s: slow and quick sinusoids along the three axes, up to about 3 m/s, and a yaw step of 60° in
0.2 s every three seconds. A geometric controller commands the rotors 200 times per second.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import RigidPlant
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST, advance_rigid
from quadpend_gym.physics.rigid_settings import pack_rigid
from quadpend_gym.physics.state import STATE_SIZE, TORQUE, State
from quadpend_gym.vehicles import RateLoop, Simulation, Vehicle, hover_thrusts, mixing, rotors_of
from quadpend_train.flights.flight_log import FlightLog, smoothed_derivative
from quadpend_train.flights.replay import spin_up_torque, without_pole

DURATION, _CONTROL = 60.0, 0.005  # s
_AMPLITUDES = np.array([[1.5, 1.2, 0.5], [0.15, 0.15, 0.12]])  # m: slow and quick
_TURN_TIMES, _TURN_ANGLES = (0.0, 0.2, 3.0, 3.2, 6.0), np.radians([0.0, 60.0, 60.0, 0.0, 0.0])  # s, rad
_FREQUENCIES = 2.0 * np.pi * np.array([[0.20, 0.23, 0.17], [0.7, 0.8, 0.9]])  # rad/s


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a log's noise, and how late and how often motion and motors are logged."""

    position: float = 0.0005  # m
    attitude: float = 0.003  # rad
    rate: float = 0.02  # rad/s
    motors: float = 0.005  # of the speed
    delay: float = 0.01  # s: the motion is logged as late
    rate_of_log: float = 100.0  # Hz


def manoeuvre(time: float) -> tuple[Floats, Floats, Floats, float]:
    """Return position (m), velocity (m/s), acceleration (m/s²), each of shape (3,), and yaw (rad) at a time (s)."""
    phase = _FREQUENCIES * time
    values = (_AMPLITUDES * np.sin(phase)).sum(axis=0)
    first = (_AMPLITUDES * _FREQUENCIES * np.cos(phase)).sum(axis=0)
    second = -(_AMPLITUDES * _FREQUENCIES**2 * np.sin(phase)).sum(axis=0)
    return values, first, second, float(np.interp(time % 6.0, _TURN_TIMES, _TURN_ANGLES))


def simulated_log(vehicle: Vehicle, seed: int, noise: Noise | None = None, duration: float = DURATION) -> FlightLog:
    """Return the log of a flight of the manoeuvre; the motor numbers are the speeds of the commanded thrusts, rad/s."""
    noise, random = noise or Noise(), np.random.default_rng(seed)
    rotors = rotors_of(vehicle)
    if rotors.thrust_coefficient is None:
        raise ValueError("the vehicle needs rotors.thrust_coefficient")
    bare = replace(without_pole(vehicle), rate_loop=RateLoop(time_constant=1.0))
    plant = RigidPlant(Simulation(vehicle=bare, interface="rotors", period=_CONTROL, substeps=1))
    hover, unmix, (low, high) = hover_thrusts(bare), np.linalg.inv(mixing(bare)), rotors.thrust
    speed = min(12.0, 0.3 / max(0.5 * sum(rotors.lags), 1e-3))  # of the attitude loop, rad/s
    inertia, weight = bare.inertia_matrix, np.array([0.0, 0.0, bare.gravity])
    state = np.zeros((1, STATE_SIZE))
    view = State(state)
    view.direction[:, 2] = 1.0
    view.velocity[:] = manoeuvre(0.0)[1]
    memory, disturbance, packed = plant.initial_memory(state), np.zeros((1, 9)), pack_rigid(plant.simulation)
    parameters = plant.simulation.parameters.as_array()[np.newaxis]
    steps = round(duration / _CONTROL)
    flown, commands = np.empty((steps, 13)), np.empty((steps, 4))
    for step in range(steps):
        flown[step] = np.hstack([view.position[0], view.velocity[0], memory[0, :ROTOR_THRUST]])
        attitude = _matrix(*memory[0, QUATERNION:BODY_RATE].tolist())
        p, v, a, yaw = manoeuvre(step * _CONTROL)
        gain = 0.25 * speed
        lift = bare.mass * (a + weight + gain**2 * (p - view.position[0]) + 2.0 * gain * (v - view.velocity[0]))
        z = lift / np.sqrt(lift @ lift)
        c, s = np.cos(yaw), np.sin(yaw)
        y = np.array([-z[2] * s, z[2] * c, z[0] * s - z[1] * c])
        y /= np.sqrt(y @ y)
        m = attitude.T @ np.column_stack([np.cross(y, z), y, z])
        turn = min(max(0.15 * (m[1, 0] - m[0, 1]), -0.15), 0.15)
        error = np.array([-m[1, 2], m[0, 2], turn])  # a tilt error that does not depend on the yaw error
        turning = speed**2 * error - 2.0 * speed * np.array([1.0, 1.0, 0.5]) * memory[0, BODY_RATE:ROTOR_THRUST]
        dragged = bare.drag.height * np.array(bare.drag.rotor) * (view.velocity[0] @ attitude)
        torque = inertia @ turning + np.array([-dragged[1], dragged[0], 0.0])  # against the drag's
        wrench = np.append(lift @ attitude[:, 2], torque)
        commands[step] = (unmix @ wrench).clip(low, high)
        gap = commands[step] - hover
        action = np.where(gap > 0.0, gap / (high - hover), gap / (hover - low))
        disturbance[:, TORQUE:] = spin_up_torque(memory, commands[step], rotors, rotors.thrust_coefficient, _CONTROL)
        advance_rigid(state, memory, action[None], action[None], disturbance, parameters, packed, _CONTROL, 1, 0)
    every = round(1.0 / (noise.rate_of_log * _CONTROL))
    late = round(noise.delay / _CONTROL)
    motion, motors = flown[: steps - late : every], np.sqrt(commands[late::every] / rotors.thrust_coefficient)
    count, period = len(motion), every * _CONTROL
    position = motion[:, :3] + noise.position * random.standard_normal((count, 3))
    turn = Rotation.from_rotvec(noise.attitude * random.standard_normal((count, 3)))
    rotation = Rotation.from_quat(motion[:, 6:10], scalar_first=True) * turn
    return FlightLog(
        "simulated",
        period,
        position,
        smoothed_derivative(position, period),
        rotation.as_quat(scalar_first=True),
        motion[:, 10:] + noise.rate * random.standard_normal((count, 3)),
        motors * (1.0 + noise.motors * random.standard_normal((count, 4))),
        has_speeds=True,
        measured=False,
        has_position=True,
        valid=np.ones(count, bool),
    )


def _matrix(w: float, x: float, y: float, z: float) -> Floats:
    """Return the rotation matrix of a quaternion."""
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
