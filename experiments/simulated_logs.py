"""A log of the simulator's own: a vehicle flies the manoeuvre for identification.

The manoeuvre lasts 60 s: slow and quick sinusoids along the three axes, up to about 3 m/s, and a yaw step of 60° in
0.2 s every three seconds. A geometric controller commands the rotors 200 times per second. If the vehicle carries its
pole, a linear-quadratic regulator of the pole and the horizontal motion demands the horizontal acceleration.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_continuous_are
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import RigidPlant
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.state import STATE_SIZE, TORQUE, State
from quadpend_gym.vehicles import RateLoop, Simulation, Vehicle, hover_thrusts, mixing, rotors_of
from quadpend_train.flight_logs.log import FlightLog, pole_motion, smoothed_derivative
from quadpend_train.flight_logs.replay import rotor_actions, spin_up_torque, without_pole

DURATION, _CONTROL = 60.0, 0.005  # s
_AMPLITUDES = np.array([[1.5, 1.2, 0.5], [0.15, 0.15, 0.12]])  # m: slow and quick
_SHARES = {0.0: 1.0, 1.0: 0.3, -1.0: 0.5}  # of the amplitudes, without a pole, with an upright and a hanging one
_TURN_TIMES, _TURN_ANGLES = (0.0, 0.2, 3.0, 3.2, 6.0), np.radians([0.0, 60.0, 60.0, 0.0, 0.0])  # s, rad
_FREQUENCIES = 2.0 * np.pi * np.array([[0.20, 0.23, 0.17], [0.7, 0.8, 0.9]])  # rad/s


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a log's noise, and how late and how often motion and motors are logged."""

    position: float = 0.0005  # m
    attitude: float = 0.003  # rad
    rate: float = 0.02  # rad/s
    motors: float = 0.005  # of the speed
    pole: float = 0.005  # of the pole's direction
    delay: float = 0.01  # s: the motion is logged as late
    rate_of_log: float = 100.0  # Hz


def manoeuvre(time: float, share: float = 1.0) -> tuple[Floats, Floats, Floats, float]:
    """Return position (m), velocity (m/s), acceleration (m/s²), each of shape (3,), and yaw (rad) at a time (s).

    `share` multiplies the amplitudes.
    """
    phase, amplitudes = _FREQUENCIES * time, share * _AMPLITUDES
    values = (amplitudes * np.sin(phase)).sum(axis=0)
    first = (amplitudes * _FREQUENCIES * np.cos(phase)).sum(axis=0)
    second = -(amplitudes * _FREQUENCIES**2 * np.sin(phase)).sum(axis=0)
    return values, first, second, float(np.interp(time % 6.0, _TURN_TIMES, _TURN_ANGLES))


def turn_error(attitude: Floats, lift: Floats, yaw: float) -> Floats:
    """Return the turn about the body axes that leads from an attitude (body to world) to a lift and a yaw, rad, (3,).

    Its tilt does not depend on the yaw error, which is limited.
    """
    z, c, s = lift / np.sqrt(lift @ lift), np.cos(yaw), np.sin(yaw)
    y = np.array([-z[2] * s, z[2] * c, z[0] * s - z[1] * c])
    y /= np.sqrt(y @ y)
    m = attitude.T @ np.column_stack([np.cross(y, z), y, z])
    return np.array([-m[1, 2], m[0, 2], min(max(0.15 * (m[1, 0] - m[0, 1]), -0.15), 0.15)])


def pole_gains(vehicle: Vehicle, speed: float, side: float) -> Floats:
    """Return the feedback of position to jerk, r and ṙ along x or y to an acceleration, shape (6,).

    The acceleration a follows with (1 + s/speed)⁻², and the pole with r̈ = (side g r − a)/λ; side is 1 for an upright
    pole and −1 for a hanging one.
    """
    a, b = np.diag([1.0, 1.0, 1.0, 0.0, 1.0], 1), np.zeros((6, 1))
    a[3, 2:5] = -(speed**2), -2.0 * speed, 0.0
    length = vehicle.pole.equivalent_length
    a[5, 2], a[5, 4], b[3] = -1.0 / length, side * vehicle.gravity / length, speed**2
    weights = np.diag([4.0, 1.0, 0.0, 0.0, 10.0, 1.0])
    return np.asarray((b.T @ solve_continuous_are(a, b, weights, np.eye(1)))[0])


def simulated_log(
    vehicle: Vehicle,
    seed: int,
    noise: Noise | None = None,
    duration: float = DURATION,
    side: float = 0.0,
) -> FlightLog:
    """Return the log of a flight of the manoeuvre; the motor numbers are the speeds of the commanded thrusts, rad/s.

    `side` is 1 for a flight with the pole upright, −1 for one with the pole hanging, and 0 for one without it.
    """
    noise, random = noise or Noise(), np.random.default_rng(seed)
    rotors, share = rotors_of(vehicle), _SHARES[side]
    if rotors.thrust_coefficient is None:
        raise ValueError("the vehicle needs rotors.thrust_coefficient")
    bare = replace(vehicle if side else without_pole(vehicle), rate_loop=RateLoop(time_constant=1.0))
    plant = RigidPlant(Simulation(vehicle=bare, interface="rotors", period=_CONTROL, substeps=1))
    hover, unmix, (low, high) = hover_thrusts(bare), np.linalg.inv(mixing(bare)), rotors.thrust
    speed = min(12.0, 0.3 / max(0.5 * sum(rotors.lags), 1e-3))  # of the attitude loop, rad/s
    inertia, weight = bare.inertia_matrix, np.array([0.0, 0.0, bare.gravity])
    mass, gains = bare.mass + abs(side) * bare.pole.mass, pole_gains(bare, speed, side) if side else None
    state = np.zeros((1, STATE_SIZE))
    view = State(state)
    view.direction[:, 2] = side or 1.0
    view.velocity[:] = manoeuvre(0.0, share)[1]
    memory, disturbance = plant.initial_memory(state), np.zeros((1, 9))
    parameters = plant.simulation.parameters.as_array()[np.newaxis]
    steps = round(duration / _CONTROL)
    flown, commands = np.empty((steps, 16)), np.empty((steps, 4))
    for step in range(steps):
        flown[step] = np.hstack([view.position[0], view.velocity[0], memory[0, :ROTOR_THRUST], view.direction[0]])
        attitude = Rotation.from_quat(memory[0, QUATERNION:BODY_RATE], scalar_first=True).as_matrix()
        p, v, a, yaw = manoeuvre(step * _CONTROL, share)
        gain = 0.25 * speed
        wanted = a + weight + gain**2 * (p - view.position[0]) + 2.0 * gain * (v - view.velocity[0])
        if gains is not None:
            turning = attitude @ np.cross(memory[0, BODY_RATE:ROTOR_THRUST], [0.0, 0.0, 1.0])
            lean = side * a / bare.gravity
            chain = [view.position[0] - p, view.velocity[0] - v, bare.gravity * attitude[:, 2] - a]
            chain += [bare.gravity * turning, view.direction[0] - lean, view.direction_rate[0]]
            wanted[:2] = (a - gains @ np.array(chain))[:2]
        lift = mass * wanted
        error = turn_error(attitude, lift, yaw)
        turning = speed**2 * error - 2.0 * speed * np.array([1.0, 1.0, 0.5]) * memory[0, BODY_RATE:ROTOR_THRUST]
        dragged = bare.drag.height * np.array(bare.drag.rotor) * (view.velocity[0] @ attitude)
        torque = inertia @ turning + np.array([-dragged[1], dragged[0], 0.0])  # against the drag's
        wrench = np.append(lift @ attitude[:, 2], torque)
        commands[step] = (unmix @ wrench).clip(low, high)
        action = rotor_actions(commands[step], hover, (low, high))
        disturbance[:, TORQUE:] = spin_up_torque(memory, commands[step], rotors, rotors.thrust_coefficient, _CONTROL)
        plant.advance(state, memory, action[None], disturbance, parameters)
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
        motion[:, 10:13] + noise.rate * random.standard_normal((count, 3)),
        motors * (1.0 + noise.motors * random.standard_normal((count, 4))),
        has_speeds=True,
        measured=False,
        has_position=True,
        valid=np.ones(count, bool),
        pole=pole_motion(motion[:, 13:] + noise.pole * random.standard_normal((count, 3)), period) if side else None,
    )
