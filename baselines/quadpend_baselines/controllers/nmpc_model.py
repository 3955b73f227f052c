"""The equations of motion in CasADi's symbols, which CasADi can differentiate: the model of `nmpc`.

The functions repeat the equations of `quadpend_gym.physics.dynamics`, one substep of `physics.euler_kernel`, and the
equations of `quadpend_gym.physics.rigid_body` under their numbers and symbols. Tests compare them. A rigid vehicle
has the same 18 numbers as state here, since its attitude stays away from the singularity of the Euler angles: equations
(3) and (4) of `quadpend_gym.physics.attitude` convert body rates and Euler-angle rates. The model has the drag
against the body rate, but no other drag, no lag of the rotors and no gyroscopic torque of the propellers.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from quadpend_gym import Parameters, Simulation
from quadpend_gym.physics.plants import EulerPlant, RigidPlant, plant_of
from quadpend_gym.physics.state import COMMAND_SIZE, DISTURBANCE_FIELDS, DISTURBANCE_SIZE, STATE_FIELDS, STATE_SIZE
from quadpend_gym.vehicles.vehicle import scaled_inertia


class Acceleration(NamedTuple):
    """Second derivatives of position, Euler angles and pendulum direction as expressions of shape (3, 1)."""

    position: Any
    euler: Any
    direction: Any


def thrust_axis(euler: Any) -> Any:
    """Return R e₃, equation (1) of `dynamics`."""
    (cr, cp, cy), (sr, sp, sy) = ca.vertsplit(ca.cos(euler)), ca.vertsplit(ca.sin(euler))
    return ca.vertcat(cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr)


def euler_acceleration(command: Any, disturbance: Any, p: Parameters) -> Any:
    """Return η̈, equation (2) of `dynamics`."""
    inertia = ca.vertcat(p.inertia_roll, p.inertia_pitch, p.inertia_yaw)
    return (command[1:] + disturbance[DISTURBANCE_FIELDS["torque"]]) / inertia


def unconstrained_acceleration(force: Any, bob_force: Any, p: Parameters) -> Any:
    """Return w = (d_B/m_c − F/M) / l of `dynamics`."""
    return (bob_force / p.bob_mass - force / p.quadrotor_mass) / p.rod_length


def direction_acceleration(r: Any, r_dot: Any, w: Any) -> Any:
    """Return r̈, equation (3) of `dynamics`."""
    return w - (ca.dot(r, w) + ca.dot(r_dot, r_dot)) * r


def centre_acceleration(force: Any, bob_force: Any, p: Parameters) -> Any:
    """Return Ẍ, equation (4) of `dynamics`."""
    return (force + bob_force) / p.total_mass - ca.vertcat(0.0, 0.0, p.gravity)


def next_state(state: Any, command: Any, disturbance: Any, p: Parameters, h: float) -> Any:
    """Return the state after one substep of length h (s), as `quadpend_gym.physics.euler_kernel` computes it."""
    x = {name: state[part] for name, part in STATE_FIELDS.items()}
    d_Q, d_B = disturbance[DISTURBANCE_FIELDS["force"]], disturbance[DISTURBANCE_FIELDS["bob_force"]]
    euler_ddot = euler_acceleration(command, disturbance, p)
    times = 0.0, 0.5 * h, h
    euler = [x["euler"] + t * (x["euler_rate"] + 0.5 * t * euler_ddot) for t in times]
    forces = [command[0] * thrust_axis(angles) + d_Q for angles in euler]
    w_0, w_m, w_1 = (unconstrained_acceleration(force, d_B, p) for force in forces)
    r, v1 = x["direction"], x["direction_rate"]
    a1 = direction_acceleration(r, v1, w_0)
    v2 = v1 + 0.5 * h * a1
    a2 = direction_acceleration(r + 0.5 * h * v1, v2, w_m)
    v3 = v1 + 0.5 * h * a2
    a3 = direction_acceleration(r + 0.5 * h * v2, v3, w_m)
    v4 = v1 + h * a3
    a4 = direction_acceleration(r + h * v3, v4, w_1)
    r_end = r + h / 6.0 * (v1 + v4 + 2.0 * (v2 + v3))
    v_end = v1 + h / 6.0 * (a1 + a4 + 2.0 * (a2 + a3))
    r_end = r_end / ca.norm_2(r_end)
    v_end = v_end - ca.dot(r_end, v_end) * r_end
    offset = p.bob_mass * p.rod_length / p.total_mass
    centre, centre_rate = x["position"] + offset * r, x["velocity"] + offset * v1
    ddot_0, ddot_m, ddot_1 = (centre_acceleration(force, d_B, p) for force in forces)
    centre = centre + h * centre_rate + h * h / 6.0 * (2.0 * ddot_m + ddot_0)
    centre_rate = centre_rate + h / 6.0 * (4.0 * ddot_m + ddot_0 + ddot_1)
    return ca.vertcat(
        centre - offset * r_end,
        centre_rate - offset * v_end,
        euler[-1],
        x["euler_rate"] + h * euler_ddot,
        r_end,
        v_end,
    )


def rotation_matrix(euler: Any) -> Any:
    """Return R = Rz(ψ) Ry(θ) Rx(φ), shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = ca.vertsplit(ca.cos(euler)), ca.vertsplit(ca.sin(euler))
    x = ca.vertcat(cy * cp, sy * cp, -sp)
    y = ca.vertcat(cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr)
    return ca.horzcat(x, y, thrust_axis(euler))


def rates_matrix(euler: Any) -> Any:
    """Return the matrix from the Euler-angle rates to the body rate, equation (3) of `attitude`, shape (3, 3)."""
    (cr, cp, _), (sr, sp, _) = ca.vertsplit(ca.cos(euler)), ca.vertsplit(ca.sin(euler))
    columns = ca.vertcat(1.0, 0.0, 0.0), ca.vertcat(0.0, cr, -sr), ca.vertcat(-sp, sr * cp, cr * cp)
    return ca.horzcat(*columns)


def rates_matrix_change(euler: Any, euler_rate: Any) -> Any:
    """Return the product of the time derivative of `rates_matrix` with the Euler-angle rates, rad/s²."""
    e, v = ca.SX.sym("e", 3), ca.SX.sym("v", 3)
    return ca.Function("change", [e, v], [ca.jtimes(rates_matrix(e) @ v, e, v)])(euler, euler_rate)


def euler_rates(euler: Any, rate: Any) -> Any:
    """Return the Euler-angle rates of a body rate, equation (4) of `attitude`."""
    (cr, cp, _), (sr, sp, _) = ca.vertsplit(ca.cos(euler)), ca.vertsplit(ca.sin(euler))
    x, y, z = ca.vertsplit(rate)
    yaw_rate = (y * sr + z * cr) / cp
    return ca.vertcat(x + yaw_rate * sp, y * cr - z * sr, yaw_rate)


def rigid_accelerations(state: Any, command: Any, disturbance: Any, simulation: Simulation) -> Acceleration:
    """Return the second derivatives of a rigid vehicle, equations (1) to (8) of `rigid_body`."""
    p, vehicle = simulation.parameters, simulation.vehicle
    inertia = scaled_inertia(vehicle, p)
    per_inertia, pivot = ca.DM(np.linalg.inv(inertia)), ca.DM(list(vehicle.pivot))
    M, m, shape = p.quadrotor_mass, p.bob_mass, vehicle.pole.inertia / (vehicle.pole.mass * vehicle.pole.length**2)
    share = shape / (1.0 + shape)
    mobility = ca.DM.eye(3) / M - ca.skew(pivot) @ per_inertia @ ca.skew(pivot)
    per_coupling = ca.DM(np.linalg.inv(np.eye(3) + m * share * np.array(mobility)))

    x = {name: state[part] for name, part in STATE_FIELDS.items()}
    d_Q, d_B, d_torque = (disturbance[DISTURBANCE_FIELDS[name]] for name in ("force", "bob_force", "torque"))
    R, E = rotation_matrix(x["euler"]), rates_matrix(x["euler"])
    rate, r, r_dot = E @ x["euler_rate"], x["direction"], x["direction_rate"]
    damping = ca.DM(list(vehicle.drag.angular)) * rate
    free = per_inertia @ (command[1:] + R.T @ d_torque - damping - ca.cross(rate, ca.DM(inertia) @ rate))
    swing = ca.cross(free, pivot) + ca.cross(rate, ca.cross(rate, pivot))
    k_0 = ca.vertcat(0.0, 0.0, command[0] / M) + R.T @ (d_Q / M - d_B / m) + swing
    rho = R.T @ r
    load = share * k_0 + ((1.0 - share) * ca.dot(rho, k_0) - p.rod_length * ca.dot(r_dot, r_dot)) * rho
    mobile, reach = m * (1.0 - share) * (mobility @ rho), per_coupling @ rho
    load = per_coupling @ load
    force = m * (load - ca.dot(mobile, load) / (1.0 + ca.dot(mobile, reach)) * reach)  # N of equation (5)

    rate_dot = free - per_inertia @ ca.cross(pivot, force)
    euler_ddot = euler_rates(x["euler"], rate_dot - rates_matrix_change(x["euler"], x["euler_rate"]))
    w = -(R @ (k_0 - mobility @ force)) / (p.rod_length * (1.0 + shape))
    gravity = ca.vertcat(0.0, 0.0, p.gravity)
    position = (command[0] * R[:, 2] + d_Q - R @ force) / M - gravity
    return Acceleration(position, euler_ddot, direction_acceleration(r, r_dot, w))


def rigid_next_state(state: Any, command: Any, disturbance: Any, simulation: Simulation, h: float) -> Any:
    """Return the state of a rigid vehicle after one Runge–Kutta step (RK4) of length h (s)."""

    def derivative(x: Any) -> Any:
        a = rigid_accelerations(x, command, disturbance, simulation)
        v = {name: x[STATE_FIELDS[name]] for name in ("velocity", "euler_rate", "direction_rate")}
        return ca.vertcat(v["velocity"], a.position, v["euler_rate"], a.euler, v["direction_rate"], a.direction)

    k1 = derivative(state)
    k2 = derivative(state + 0.5 * h * k1)
    k3 = derivative(state + 0.5 * h * k2)
    k4 = derivative(state + h * k3)
    return state + h / 6.0 * (k1 + k4 + 2.0 * (k2 + k3))


def period_map(simulation: Simulation) -> Any:
    """Return the CasADi function (x, u, d) → x⁺ over one period of the simulation, with its substeps.

    Its arguments are a state, shape (18, 1), thrust (N) and torques (N·m), shape (4, 1), and the disturbance (N and
    N·m), shape (9, 1); the function also takes n columns.
    """
    x, u, d = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", COMMAND_SIZE), ca.SX.sym("d", DISTURBANCE_SIZE)
    y, h = x, simulation.period / simulation.substeps
    substeps: dict[type, tuple[Any, Any]] = {
        EulerPlant: (next_state, simulation.parameters),
        RigidPlant: (rigid_next_state, simulation),
    }
    substep, settings = substeps[type(plant_of(simulation))]
    for _ in range(simulation.substeps):
        y = substep(y, u, d, settings, h)
    return ca.Function("period_map", [x, u, d], [y])
