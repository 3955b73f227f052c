"""The paper's controller in continuous time: observers as differential equations, integrated with the plant.

The observers (13), (20), (46), (47), corrected, with e = y − x̂₁ and the polynomial s⁴ + λ₃s³ + … + λ₀ of
`quadpend_baselines.estimation.observers`:

    x̂̇₁ = x̂₂ + λ₃ e,   x̂̇₂ = x̂₃ + λ₂ e [+ u],   x̂̇₃ = x̂₄ + λ₁ e,   x̂̇₄ = λ₀ e [+ u]   or   ρ sat(λ₀ e / ρ)

The known input u enters the equation of the state that it drives. The control law is that of
`quadpend_baselines.controllers.adrc`, evaluated at every stage of a classical Runge–Kutta step. The commands have the
same limits as in the sampled controller.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from quadpend_baselines.controllers import adrc
from quadpend_baselines.estimation import deso
from quadpend_baselines.estimation.chains import OBSERVERS_SIZE, AdrcMeasurement, make_measurement
from quadpend_baselines.estimation.observers import characteristic_polynomial
from quadpend_baselines.modelling.quantities import Derivatives
from quadpend_baselines.policy.protocol import to_action, to_command
from quadpend_gym import PAPER, Reference, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import STATE_SIZE
from quadpend_gym.physics.vectors import Four, Vec3


@dataclass(frozen=True)
class Trajectory:
    """A trajectory at m times."""

    time: Floats  # s, shape (m,)
    state: Floats  # see `quadpend_gym.physics.state`, shape (m, 18)
    reference: Floats  # derivatives of order 0 to 6 of F_x, F_y, z and ψ, shape (m, 7, 4)
    command: Floats  # thrust (N) and torques τφ, τθ, τψ (N·m), shape (m, 4)
    disturbance: Floats  # the true disturbance, N and N·m, in the layout of `Disturbance`, shape (m, 9)
    estimate: Floats  # the disturbance that the observers estimate, shape (m, 9)

    @property
    def outputs(self) -> Floats:
        """F_x, F_y, z (m) and ψ (rad), shape (m, 4)."""
        s = State(self.state)
        bob = s.position + PAPER.rod_length * s.direction
        return np.column_stack([bob[:, :2], s.position[:, 2], s.euler[:, 2]])

    @property
    def error(self) -> Floats:
        """Tracking errors of F_x, F_y, z (m) and ψ (rad), shape (m, 4)."""
        return np.asarray(self.outputs - self.reference[:, 0])


class ContinuousLoop:
    """Plant, observers and control law of `policy` as one differential equation; its sampling period has no effect.

    The state of the loop is that of the plant, shape (18,), followed by those of the m observers, shape (4 m,).
    """

    def __init__(self, policy: Any) -> None:
        self.policy, bank, self._model = policy, policy.estimator, policy.estimator.model.numbers
        self._law = adrc.AdrcLaw(policy.gains, policy.simulation)
        # A law without the DESOs of the force does not use their estimates.
        driven, observers = zip(*bank.observers, *bank.observers[2 : 10 - len(bank.observers)], strict=True)
        self._driven = np.arange(len(driven)), np.array(driven)
        self._gains = np.array([characteristic_polynomial(item)[1:] for item in observers])
        self._limits = np.array([np.inf if item.switching is None else item.switching for item in observers])
        for gain, limit, item in zip(self._gains, self._limits, observers, strict=True):
            if item.layer is not None:  # the slope λ₀ becomes ρ/δ; a very small δ approximates the sign function
                gain[3] = limit / max(item.layer, 1e-300)

    def simulate(self, start: Floats, reference: Reference, disturbance: Floats, step: float, every: int) -> Trajectory:
        """Integrate the loop and record every `every`-th step of `step` s, from a state of the plant, shape (18,).

        The true disturbance, N and N·m, is given at every half step, shape (2 m + 1, 9), for m steps.
        """
        steps = disturbance.shape[0] // 2
        references = reference.derivatives(0.5 * step * np.arange(2 * steps + 1))
        estimate = np.zeros((OBSERVERS_SIZE, 1))
        deso.begin_observers(self._measure(start, references[0]), self._model, estimate, 0)
        loop, records = np.concatenate([start, estimate[:, 0]]), []
        for i in tqdm(range(steps + 1), unit="step", unit_scale=True, leave=False, desc="continuous time"):
            now = slice(2 * i, 2 * i + 3)
            if i % every == 0:
                records.append((loop, self._control(loop, references[2 * i])[1][0]))
            if i < steps:
                loop = self._advance(loop, references[now], disturbance[now], step)
        loops, commands = (np.array(part) for part in zip(*records, strict=True))
        return Trajectory(
            step * every * np.arange(len(records), dtype=np.float64),
            loops[:, :STATE_SIZE],
            references[:: 2 * every],
            commands,
            disturbance[:: 2 * every],
            np.array([self._forces(row) for row in loops[:, STATE_SIZE:]]),
        )

    def _advance(self, loop: Floats, references: Floats, disturbances: Floats, h: float) -> Floats:
        """Return the loop one step of h (s) later, from inputs at its start, middle and end; |r| = 1 and r·ṙ = 0."""
        k1 = self._rate(loop, references[0], disturbances[0])
        k2 = self._rate(loop + 0.5 * h * k1, references[1], disturbances[1])
        k3 = self._rate(loop + 0.5 * h * k2, references[1], disturbances[1])
        k4 = self._rate(loop + h * k3, references[2], disturbances[2])
        for rate, share in ((k1, 1 / 6), (k2, 1 / 3), (k3, 1 / 3), (k4, 1 / 6)):
            loop = loop + share * h * rate
        s = State(loop[:STATE_SIZE])
        s.direction[:] /= np.linalg.norm(s.direction)
        s.direction_rate[:] -= (s.direction @ s.direction_rate) * s.direction
        return loop

    def _forces(self, chains: Floats) -> Floats:
        """Return the disturbance that the observers estimate, shape (9,)."""
        forces = deso.estimated_forces(chains.reshape(-1, 1), 0, self.policy.gains.mismatch, self._model)
        return np.concatenate(forces)

    def _measure(self, state: Floats, reference: Floats) -> AdrcMeasurement:
        s = State(state)
        bob = s.position + self.policy.simulation.parameters.rod_length * s.direction
        error = np.array([bob[0], bob[1], s.position[2]]) - reference[0, :3]
        euler = s.euler - [0.0, 0.0, reference[0, 3]]
        still = [Vec3(0.0, 0.0, 0.0)] * 2  # without drag
        wanted = Derivatives._make([*(Vec3(*row) for row in reference[2:, :3]), Vec3(*reference[:3, 3]), *still])
        return make_measurement(Vec3(*error), Vec3(*s.direction), Vec3(*euler), wanted, self._model, None)

    def _control(self, loop: Floats, reference: Floats) -> tuple[AdrcMeasurement, Floats]:
        """Return the measurement and the saturated command, shape (1, 4)."""
        policy, measurement = self.policy, self._measure(loop[:STATE_SIZE], reference)
        lanes = loop[STATE_SIZE:].reshape(-1, 1)
        command = adrc.adrc(measurement, lanes, 0, self._law.numbers, self._model)
        action = to_action(np.array([command]), policy.simulation)
        return measurement, to_command(action, policy.simulation)

    def _rate(self, loop: Floats, reference: Floats, disturbance: Floats) -> Floats:
        """Return the rates of change of the loop."""
        policy, (measurement, command) = self.policy, self._control(loop, reference)
        state, estimate, model = loop[:STATE_SIZE], loop[STATE_SIZE:].reshape(-1, 4), self._model
        error = np.array(deso.observer_outputs(measurement, model)) - estimate[:, 0]
        rate = self._gains * error[:, np.newaxis]
        rate[:, 3] = np.clip(rate[:, 3], -self._limits, self._limits)
        rate[:, :3] += estimate[:, 1:]
        lanes = loop[STATE_SIZE:].reshape(-1, 1)
        known = measurement, lanes, 0, Four(*command[0]), policy.gains.mismatch, model
        rate[self._driven] += deso.observer_inputs(*known)
        s, a = State(state), accelerations(state, command[0], disturbance, policy.simulation.parameters)
        parts = [s.velocity, a.position, s.euler_rate, a.euler, s.direction_rate, a.direction, rate.ravel()]
        return np.concatenate(parts)
