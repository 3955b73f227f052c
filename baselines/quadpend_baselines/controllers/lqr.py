"""LQR and LQI: optimal linear feedback around the trajectory that follows the reference.

    (1)  u = u_d − K (x − x_d),   K = (R + BᵀPB)⁻¹ BᵀPA       P: discrete algebraic Riccati equation
    (2)  J = ½ Σ (x_kᵀ Q x_k + u_kᵀ R u_k) = ½ x₀ᵀ P x₀

x and u are those of `linear_model`, rotated into the axes of the heading. x_d and u_d are the trajectory of
`flat_outputs` without wind. Q weights the errors of the flat outputs e = (ζ_x + l r_x, ζ_y + l r_y, ζ_z), their rates,
roll, pitch, yaw and the angular rates. Each weight is the inverse square of a tolerance (Bryson's rule).

For rigid vehicles, x_d and u_d are those of the equivalent pendulum (`modelling.equivalent`), and A and B are those of
the rigid body with its pivot and drag.

LQI appends the integrals σ_{k+1} = σ_k + T e_k to x. It integrates only while the command is within the limits of the
actuators (anti-windup), and each component of σ is bounded. The norm of the horizontal position error is limited to
`LqrGains.reach`, because linear feedback of a larger error would tilt the pendulum so far that it falls.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_discrete_are

from quadpend_baselines.controllers.law import Law
from quadpend_baselines.estimation.estimate import Estimate, law_inputs
from quadpend_baselines.gains import EstimatorGains, NotNegative, Positive, Scale
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    body_command,
    equivalent_model,
    follow,
    unpack_pendulum,
)
from quadpend_baselines.modelling.linear_model import (
    EULER,
    EULER_RATE,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    POSITION,
    VELOCITY,
    linearise,
    model_state,
)
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    bob_offset,
    calm,
    combine,
    limit_length,
    turn3,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import settings
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.rotors import allocate, clip4, wrench_of
from quadpend_gym.physics.vectors import Four, Vec3, load, minus4, store, store_four

_OUTPUTS = 3


@settings
class LqrGains:
    """Gains of `controllers.lqr`: the weights are inverse squares of tolerances."""

    position: Annotated[Positive, Scale(-2)] = 0.3  # m
    velocity: Annotated[Positive, Scale(-1)] = 0.6  # m/s
    angle: Positive = 0.5  # rad
    angle_rate: Annotated[Positive, Scale(1)] = 3.0  # rad/s
    effort: Positive = 1.0  # share of the range of the action
    reach: Annotated[Positive, Scale(-2)] = 0.5  # m, limit of the horizontal position error in the feedback
    integral: Annotated[NotNegative, Scale(-3)] = 0.0  # m·s; 0: no integrators; only `lqi` has them
    integral_limit: Annotated[NotNegative, Scale(-3)] = 0.5  # m·s
    estimator: EstimatorGains = EstimatorGains()


def output_matrix(rod_length: float) -> Floats:
    """Return C of e = C x, shape (3, 16)."""
    out = np.zeros((_OUTPUTS, MODEL_STATE_SIZE))
    out[:, POSITION] = np.eye(_OUTPUTS)
    out[:2, PENDULUM] = rod_length * np.eye(2)
    return out


@lru_cache(maxsize=32)
def weights(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return Q and R of equation (2), shapes (16, 16), or (19, 19) with integrators, and (4, 4)."""
    output = output_matrix(simulation.parameters.rod_length)
    output_rate = np.zeros_like(output)
    output_rate[:, VELOCITY], output_rate[:, PENDULUM_RATE] = output[:, POSITION], output[:, PENDULUM]
    state = output.T @ output / gains.position**2 + output_rate.T @ output_rate / gains.velocity**2
    angle, angle_rate = np.zeros(MODEL_STATE_SIZE), np.zeros(MODEL_STATE_SIZE)
    angle[EULER] = gains.angle**-2
    angle_rate[EULER_RATE] = gains.angle_rate**-2
    state += np.diag(angle + angle_rate)
    if gains.integral > 0.0:
        state = block_diag(state, np.eye(_OUTPUTS) / gains.integral**2)
    return state, np.diag((gains.effort * equivalent_model(simulation).simulation.command_scale) ** -2.0)


def model(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return A and B of the model for which the gain K is designed, including the integrators of LQI."""
    transition, input_matrix, _ = linearise(simulation)
    if gains.integral > 0.0:
        output = simulation.period * output_matrix(simulation.parameters.rod_length)
        transition = np.block([[transition, np.zeros((MODEL_STATE_SIZE, _OUTPUTS))], [output, np.eye(_OUTPUTS)]])
        input_matrix = np.concatenate([input_matrix, np.zeros((_OUTPUTS, input_matrix.shape[1]))])
    return transition, input_matrix


@lru_cache(maxsize=32)
def riccati(gains: LqrGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return K of equation (1) and P of equation (2)."""
    (A, B), (Q, R) = model(gains, simulation), weights(gains, simulation)
    P = solve_discrete_are(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A).astype(np.float64)
    return gain, P.astype(np.float64)


def varying_gains(A: Floats, B: Floats, Q: Floats, R: Floats, P: Floats) -> Floats:
    """Return the gains K_k of the regulator along a flight of N control steps, shape (N, m, n).

    K_k = (R + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ P_{k+1} A_k,    P_k = Q + A_kᵀ P_{k+1} (A_k − B_k K_k),    P_N = P
    """
    gains = np.empty((len(A), B.shape[2], A.shape[1]))
    for k in range(len(A) - 1, -1, -1):
        gains[k] = np.linalg.solve(R + B[k].T @ P @ B[k], B[k].T @ P @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ gains[k])
        P = 0.5 * (P + P.T)
    return gains


class LqrNumbers(NamedTuple):
    """What the law needs besides the gain K, inside compiled functions."""

    reach: float  # limit of the horizontal position error in the feedback, m
    integral_limit: float  # of each component of σ, m·s
    period: float  # T, s
    command_scale: Four  # see `Simulation.command_scale`


unpack_numbers = unpacker(LqrNumbers)


@inlined
def deviation(
    s: VehicleState, disturbance: Forces, reference: Derivatives, model: Pendulum, rigid: RigidSettings | None
) -> tuple[VehicleState, Four]:
    """Return x − x_d in the axes of the heading, and u_d (N, N·m), which follow the reference under a disturbance."""
    sine, cosine = sincos(s.euler.z)
    # The desired roll and pitch are computed for the actual heading, not for the desired one.
    yaw, d = reference.yaw, reference
    heading = Derivatives(d.d2, d.d3, d.d4, d.d5, d.d6, Vec3(s.euler.z, yaw.y, yaw.z), d.d1, d.drag)
    wanted, command, acting = follow(heading, disturbance, model)
    command = body_command(wanted, command, acting, model, rigid)
    x = combine(-1.0, wanted, s)
    return (
        VehicleState(
            turn3(x.position, -sine, cosine),
            turn3(x.velocity, -sine, cosine),
            Vec3(x.euler.x, x.euler.y, s.euler.z - yaw.x),
            x.euler_rate,
            turn3(x.direction, -sine, cosine),
            turn3(x.direction_rate, -sine, cosine),
        ),
        command,
    )


@inlined
def feedback(x: Any, gain: Any, first: int) -> Four:
    """Return the product of x and the columns of a matrix with four rows from `first`."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(len(x)):
        a += gain[0, first + i] * x[i]
        b += gain[1, first + i] * x[i]
        c += gain[2, first + i] * x[i]
        d += gain[3, first + i] * x[i]
    return Four(a, b, c, d)


@inlined
def _attained(command: Four, scale: Four, rigid: RigidSettings | None) -> Four:
    """Return thrust (N) and torques (N·m) within the limits of the vehicle."""
    if rigid is None:
        low = Four(0.0, -scale.b, -scale.c, -scale.d)
        return clip4(command, low, Four(2.0 * scale.a, scale.b, scale.c, scale.d))
    if rigid.rotors.has_rotors == 0.0:
        return clip4(command, rigid.rotors.lowest, rigid.rotors.highest)
    return wrench_of(allocate(command, rigid.rotors), rigid.rotors)


@inlined
def _excess(attained: float, command: float) -> float:
    """Return a number above zero if a command is not attained."""
    return abs(attained - command) - 1e-3 - 1e-5 * abs(command)


@inlined
def lqr(
    s: VehicleState,
    reference: Derivatives,
    integral: Vec3,
    gain: Any,
    numbers: LqrNumbers,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> tuple[Four, Vec3]:
    """Return thrust (N) and torques (N·m) of equation (1), and the integrals σ (m·s, world frame) after this step."""
    x, command = deviation(s, calm(), reference, model, rigid)
    position = limit_length(x.position, numbers.reach)
    x = VehicleState(position, x.velocity, x.euler, x.euler_rate, x.direction, x.direction_rate)
    command = minus4(command, feedback(model_state(x, 0.0, 1.0), gain, 0))
    if gain.shape[1] == MODEL_STATE_SIZE:
        return command, integral
    sine, cosine = sincos(s.euler.z)
    command = minus4(command, feedback(turn3(integral, -sine, cosine), gain, MODEL_STATE_SIZE))
    error, applied = turn3(bob_offset(x, model.vehicle.rod_length)[0], sine, cosine), numbers.command_scale
    applied = _attained(command, applied, rigid)
    excess = max(
        max(_excess(applied.a, command.a), _excess(applied.b, command.b)),
        max(_excess(applied.c, command.c), _excess(applied.d, command.d)),
    )
    step, limit = select(excess > 0.0, 0.0, numbers.period), numbers.integral_limit
    return command, Vec3(
        min(max(integral.x + step * error.x, -limit), limit),
        min(max(integral.y + step * error.y, -limit), limit),
        min(max(integral.z + step * error.z, -limit), limit),
    )


@compiled
def _commands(estimate: Floats, memory: Floats, packed: Any, packed_rigid: Floats | None, outs: Any) -> None:
    gain, limits, pendulum = packed[0], unpack_numbers(packed[1]), unpack_pendulum(packed[2])
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    out, memory_out = outs
    for row in range(out.shape[0]):
        state, _, wanted = law_inputs(estimate, row)
        command, integral = lqr(state, wanted, load(memory.T, 0, row), gain, limits, pendulum, rigid)
        store_four(out.T, 0, row, command)
        store(memory_out.T, 0, row, integral)


@dataclass(frozen=True)
class Lqr(Law):
    """The control law (1) for n rows, with integrators if `gains.integral` is positive."""

    gains: LqrGains
    flies_load = True

    @cached_property
    def _numbers(self) -> tuple[Any, Floats | None]:
        gains, simulation, model = self.gains, self.simulation, equivalent_model(self.simulation)
        scale = Four(*simulation.command_scale.tolist())
        numbers = pack(LqrNumbers(gains.reach, gains.integral_limit, simulation.period, scale))
        return (np.ascontiguousarray(riccati(gains, simulation)[0]), numbers, model.packed), model.packed_rigid

    def initial_memory(self, rows: int) -> Floats:
        """Return σ = 0, shape (rows, 3), m·s."""
        return np.zeros((rows, _OUTPUTS))

    def command(self, estimate: Estimate, memory: Floats) -> tuple[Floats, Floats]:
        """Return the command of equation (1) and the integrals σ; see `law.Law`."""
        out, after = np.empty((len(memory), 4)), np.empty_like(memory)
        _commands(estimate.array, memory, *self._numbers, (out, after))
        return out, after
