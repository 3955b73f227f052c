"""The numbers of a rigid vehicle that compiled functions read."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics import rotors as codes
from quadpend_gym.physics.plant_kernel import LOOP_EFFICIENCY
from quadpend_gym.physics.rotors import RateLoopSettings, RotorSettings, rate_loop_gains
from quadpend_gym.physics.vectors import Four, Matrix4, Symmetric, Vec3, load_four
from quadpend_gym.vehicles import Simulation, hover_wrench, mixing

# Numbers of a vehicle and its interface that may differ from one episode to another, see `randomization.LoopRanges`:
# `RotorSettings.efficiency`; both gains of `RateLoopSettings`; the last two shares of `RotorSettings.rise` and `fall`.
_RATE_GAIN, _TORQUE_GAIN, _RISE, _FALL = 4, 5, 6, 8
_CODES = {"wrench": codes.WRENCH, "body_rates": codes.BODY_RATES, "rotors": codes.ROTOR_THRUSTS}


class RigidSettings(NamedTuple):
    """A rigid vehicle with its interface."""

    interface: float  # code of the interface, see `rotors`
    command_scale: Four  # thrust at a zero action (N), and torques (N·m) or body rates (rad/s) at an action of 1
    trim: Vec3  # torque about x and y at a zero action that balances a pole beside the centre of mass, N·m
    correlation: Vec3  # products of inertia divided by the roots of the moments: xy, xz, yz
    pivot: Vec3  # p, m, body frame
    shape: float  # J/(m l²) of the pole
    rotor_drag: Vec3  # drag of the rotors, N·s/m, body frame
    drag_height: float  # height above the centre of mass where the drag of the rotors acts, m
    angular_drag: Vec3  # torque against the body rate, N·m·s/rad, body frame
    reach: float  # L/l: distance of the pole's upper end from the pivot, divided by that of its centre of mass
    loop: RateLoopSettings  # the on-board rate loop
    rotors: RotorSettings  # the rotors


unpack_rigid = unpacker(RigidSettings)


@inlined
def with_loop(rigid: RigidSettings, loops: Any, lane: int) -> RigidSettings:
    """Return the settings with the numbers in column `lane` of `loops`, see `LOOP_SIZE`."""
    nominal = rigid.rotors
    rotors = RotorSettings(
        nominal.has_rotors,
        nominal.mixing,
        load_four(loops, LOOP_EFFICIENCY, lane),
        nominal.unmixing,
        nominal.hover,
        nominal.lowest,
        nominal.highest,
        nominal.spins,
        Vec3(nominal.rise.x, loops[_RISE, lane], loops[_RISE + 1, lane]),
        Vec3(nominal.fall.x, loops[_FALL, lane], loops[_FALL + 1, lane]),
        nominal.momentum,
    )
    return RigidSettings(
        rigid.interface,
        rigid.command_scale,
        rigid.trim,
        rigid.correlation,
        rigid.pivot,
        rigid.shape,
        rigid.rotor_drag,
        rigid.drag_height,
        rigid.angular_drag,
        rigid.reach,
        RateLoopSettings(loops[_RATE_GAIN, lane], loops[_TORQUE_GAIN, lane], rigid.loop.inertia),
        rotors,
    )


def loop_numbers(simulation: Simulation, rate_loop: float, rotor_lag: float, thrust: float) -> list[float]:
    """Return the `LOOP_SIZE` numbers for factors of the time constants of rate loop and rotors, and of the thrust."""
    vehicle, step = simulation.vehicle, simulation.period / simulation.substeps
    lags = [rotor_lag * lag for lag in ((0.0, 0.0) if vehicle.rotors is None else vehicle.rotors.lags)]
    gains = rate_loop_gains(rate_loop * vehicle.rate_loop.time_constant, 0.5 * (lags[0] + lags[1]), step)
    return [*(thrust,) * 4, *gains, *_decays(lags[0], step)[1:], *_decays(lags[1], step)[1:]]


@lru_cache(maxsize=128)
def nominal_loop(simulation: Simulation) -> Floats:
    """Return the loop without random constants and without latency, shape (10 + s,), see `plant_kernel`."""
    return np.array([*loop_numbers(simulation, 1.0, 1.0, 1.0), *[0.0] * simulation.substeps])


def _symmetric(a: Floats) -> Symmetric:
    return Symmetric(*a[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist())


@lru_cache(maxsize=128)
def make_rigid_settings(simulation: Simulation) -> RigidSettings:
    """Return the settings of a simulation whose vehicle is rigid."""
    vehicle, step = simulation.vehicle, simulation.period / simulation.substeps
    inertia = vehicle.inertia_matrix
    size = np.sqrt(np.diag(inertia))
    correlation = inertia / np.outer(size, size)
    pole, parameters = vehicle.pole, simulation.parameters
    hover = hover_wrench(parameters, vehicle.pivot)
    rotors = vehicle.rotors
    if rotors is None:
        forward = np.eye(4)
        roll_pitch, yaw = simulation.torque_limits
        reach = np.array([hover[0], roll_pitch, roll_pitch, yaw])
        low, high = hover - reach, hover + reach
        lags, spins, momentum = (0.0, 0.0), np.zeros(4), 0.0
    else:
        forward = mixing(vehicle)
        low, high = np.full(4, rotors.thrust[0]), np.full(4, rotors.thrust[1])
        lags, spins = rotors.lags, np.array(rotors.spins, float)
        coefficient = rotors.thrust_coefficient
        momentum = 0.0 if coefficient is None else rotors.inertia / np.sqrt(coefficient)
    backward = np.linalg.inv(forward)
    gains = rate_loop_gains(vehicle.rate_loop.time_constant, 0.5 * (lags[0] + lags[1]), step)
    settings = RotorSettings(
        0.0 if rotors is None else 1.0,
        Matrix4(*(Four(*row) for row in forward.tolist())),
        Four(1.0, 1.0, 1.0, 1.0),
        Matrix4(*(Four(*row) for row in backward.tolist())),
        Four(*(backward @ hover).tolist()),
        Four(*low.tolist()),
        Four(*high.tolist()),
        Four(*spins.tolist()),
        _decays(lags[0], step),
        _decays(lags[1], step),
        float(momentum),
    )
    return RigidSettings(
        _CODES[simulation.interface],
        Four(*simulation.command_scale.tolist()),
        Vec3(*hover[1:].tolist()),
        Vec3(correlation[0, 1], correlation[0, 2], correlation[1, 2]),
        Vec3(*vehicle.pivot),
        pole.inertia / (parameters.bob_mass * parameters.rod_length**2),
        Vec3(*vehicle.drag.rotor),
        vehicle.drag.height,
        Vec3(*vehicle.drag.angular),
        pole.full_length / pole.length,
        RateLoopSettings(*gains, _symmetric(inertia)),
        settings,
    )


def _decays(lag: float, step: float) -> Vec3:
    """Return the shares of a thrust error that are left at the start, the middle and the end of a substep."""
    if lag == 0.0:
        return Vec3(0.0, 0.0, 0.0)
    return Vec3(1.0, float(np.exp(-0.5 * step / lag)), float(np.exp(-step / lag)))


@lru_cache(maxsize=128)
def pack_rigid(simulation: Simulation) -> Floats:
    """Return the settings of a rigid vehicle as a flat array that `unpack_rigid` reads."""
    packed = pack(make_rigid_settings(simulation))
    packed.flags.writeable = False
    return packed
