"""LQG: linear-quadratic feedback of a Kalman filter near the reference, the flatness-based cascade elsewhere.

    (1)  a = s a_near + (1 − s) a_far
    (2)  a_near = a_d − F z,    F = (R + BᵀPB)⁻¹ BᵀPA,    J = Σ |e|² + q² ψ² + ρ (|a|² + |δf|²)
    (3)  a_far                                                       the action of `flatness`
    (4)  s, with ε = √(T zᵀ P z)                                      as in `dual_mode`

z are the deviations from the trajectory in still air: the state of `linear_model`, the thrusts f of the rotors, and the
estimated wind, which is expected to fade with a time constant (`wind_time`: a first-order Gauss–Markov process). A and
B lead from actions to z, with the rate loop and the lag of the rotors. δf is the deviation of f as a share of its value
at hover, so that √ρ (`effort`) weighs commands and thrusts. a_d follows the reference, see `modelling.equivalent`. z is
predicted to the time when the action begins to act, through the known latency: for a known delay this is the optimal
feedback of the delayed actions.

The Kalman filter is `estimation.kalman` with the same linear model: its noise is that of the sensors, and the forces
of the wind are random walks as strong as the assumed wind, σ √(2/τ) for its standard deviation σ and time constant τ.
`torque_noise` is a white noise of the torque that no wind makes. It bounds the delay margin from below, together with
ρ: LQG guarantees none (Doyle, IEEE Transactions on Automatic Control 23(4), 1978), and with more of both the loop
relies less on the model.
"""

from dataclasses import astuple, dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np
from scipy.linalg import solve_discrete_are

from quadpend_baselines.controllers.dual_mode import near_share
from quadpend_baselines.controllers.flatness import FlatnessGains, flatness
from quadpend_baselines.controllers.law import Law
from quadpend_baselines.controllers.lqr import deviation, output_matrix
from quadpend_baselines.estimation.estimate import MASS_RATIO, RIGID_PART, Estimate, law_inputs
from quadpend_baselines.gains import EstimatorGains, NotNegative, Positive, Scale
from quadpend_baselines.modelling.equivalent import equivalent_model, unpack_pendulum
from quadpend_baselines.modelling.linear_model import (
    EULER,
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_FORCE,
    MODEL_STATE_SIZE,
    MODEL_TORQUE,
    linearise_actions,
    model_state,
)
from quadpend_baselines.modelling.quantities import calm, turn3
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import settings
from quadpend_gym.physics.attitude import body_rate
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import BODY_RATE, RIGID_SIZE, ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.physics.vectors import Vec3, axpy, multiply, store, store_four

_LEAST = 1e-6  # m, the tracking error that counts as much as any state of 1


@settings
class LqgGains:
    """Gains of `controllers.lqg`."""

    far: FlatnessGains = FlatnessGains()  # far from the reference; its estimator is not used
    effort: Annotated[Positive, Scale(-2)] = 0.03  # m, the tracking error that counts as much as an action of 1
    wind_time: Positive = 3.0  # s, time constant with which the feedback expects the estimated wind to fade
    yaw: Annotated[Positive, Scale(-2)] = 0.1  # m, the tracking error that counts as much as a yaw error of 1 rad
    near_error: Annotated[NotNegative, Scale(-2.5)] = 0.09  # ε₀, m √s: below ε₀ and α₀ only the law near the reference
    far_error: Annotated[NotNegative, Scale(-2.5)] = 0.16  # ε₁, m √s: above ε₁ or α₁ only the law far from it
    near_tilt: NotNegative = 0.15  # α₀, rad
    far_tilt: NotNegative = 0.3  # α₁, rad
    estimator: EstimatorGains = EstimatorGains(models_loop=True)


unpack_gains = unpacker(LqgGains)


@lru_cache(maxsize=32)
def riccati(gains: LqgGains, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return F and P of equation (2), shapes (4, n) and (n, n); n is 28 for rigid vehicles, and else 24."""
    A, B, E = linearise_actions(simulation)
    decay = np.exp(-simulation.period / gains.wind_time) * np.eye(MODEL_DISTURBANCE_SIZE)
    A, B = np.block([[A, E], [np.zeros(E.T.shape), decay]]), np.pad(B, ((0, MODEL_DISTURBANCE_SIZE), (0, 0)))
    output = np.pad(output_matrix(simulation.parameters.rod_length), ((0, 0), (0, len(A) - MODEL_STATE_SIZE)))
    Q, R = output.T @ output + _LEAST**2 * np.eye(len(A)), gains.effort**2 * np.eye(ACTION_SIZE)
    Q[EULER, EULER][2, 2] += gains.yaw**2
    for thrust in range(MODEL_STATE_SIZE, len(A) - MODEL_DISTURBANCE_SIZE):
        Q[thrust, thrust] += (gains.effort * ACTION_SIZE / simulation.parameters.hover_thrust) ** 2
    P = solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A).astype(np.float64), P.astype(np.float64)


@compiled
def _deviations(estimate: Floats, packed: Any, packed_rigid: Floats | None, outs: Any) -> None:
    """Write the command of `flatness`, u_d, rates and thrusts of the desired trajectory, x − x_d and s."""
    gains, pendulum = unpack_gains(packed[0]), unpack_pendulum(packed[1])
    cost, period = packed[2], packed[3]
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    far, command, desired, x, share = outs
    for row in range(far.shape[0]):
        state, forces, reference = law_inputs(estimate, row)
        store_four(far.T, 0, row, flatness(state, forces, reference, gains.far, pendulum, rigid))
        error, wanted = deviation(state, calm(), reference, pendulum, rigid)
        store_four(command.T, 0, row, wanted)
        deviations = model_state(error, 0.0, 1.0)
        for i in range(MODEL_STATE_SIZE):
            x[row, i] = deviations[i]
        if rigid is not None:
            euler = Vec3(state.euler.x - error.euler.x, state.euler.y - error.euler.y, state.euler.z)
            rate = body_rate(euler, axpy(-1.0, error.euler_rate, state.euler_rate))
            store(desired.T, BODY_RATE, row, rate)
            thrusts = multiply(rigid.rotors.unmixing, wanted)
            store_four(desired.T, ROTOR_THRUST, row, thrusts)
            for i in range(ACTION_SIZE):
                thrust = estimate[row, RIGID_PART + ROTOR_THRUST + i] / estimate[row, MASS_RATIO]
                x[row, MODEL_STATE_SIZE + i] = thrust - thrusts[i]
        sine, cosine = sincos(state.euler.z)
        wind = x.shape[1] - MODEL_DISTURBANCE_SIZE
        force, bob_force = turn3(forces.force, -sine, cosine), turn3(forces.bob_force, -sine, cosine)
        torque = forces.torque if rigid is None else turn3(forces.torque, -sine, cosine)
        for i in range(3):
            x[row, wind + MODEL_FORCE.start + i], x[row, wind + MODEL_TORQUE.start + i] = force[i], torque[i]
        for i in range(2):
            x[row, wind + MODEL_BOB_FORCE.start + i] = bob_force[i]
        remaining = 0.0
        for i in range(x.shape[1]):
            for j in range(x.shape[1]):
                remaining += x[row, i] * cost[i, j] * x[row, j]
        share[row, 0] = near_share(state, np.sqrt(period * max(remaining, 0.0)), gains)


@dataclass(frozen=True)
class Lqg(Law):
    """The control law (1)–(4) for n rows; its commands are actions."""

    gains: LqgGains
    is_linear_near = True
    commands_actions = True

    @cached_property
    def _numbers(self) -> tuple[Any, Floats | None, Floats]:
        model = equivalent_model(self.simulation)
        feedback, cost = (np.ascontiguousarray(matrix) for matrix in riccati(self.gains, self.simulation))
        packed = pack(astuple(self.gains)), model.packed, cost, self.simulation.period
        return packed, model.packed_rigid, feedback

    def command(self, estimate: Estimate, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the actions of equation (1), shape (n, 4), which can exceed [−1, 1]; the memory stays empty."""
        by_flatness, following, x, share = evaluate(self, estimate)
        return by_flatness + share * (following - x @ self._numbers[2].T - by_flatness), memory


def evaluate(law: Lqg, estimate: Estimate) -> tuple[Floats32, Floats32, Floats, Floats]:
    """Return a_far, a_d, z and s of n rows, shapes (n, 4), (n, 4), (n, 28) and (n, 1)."""
    packed, packed_rigid, feedback = law._numbers
    rows, plant = len(estimate.array), plant_of(law.simulation)
    far, command, desired = np.empty((rows, 4)), np.empty((rows, 4)), np.empty((rows, RIGID_SIZE))
    x, share = np.empty((rows, feedback.shape[1])), np.empty((rows, 1))
    _deviations(estimate.array, packed, packed_rigid, (far, command, desired, x, share))
    return plant.actions_for(far, estimate.rigid), plant.actions_for(command, desired), x, share
