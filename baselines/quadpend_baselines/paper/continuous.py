"""The paper's controller in continuous time: observers as differential equations, integrated with the plant.

The observers (13), (20), (46), (47), corrected, with e = y − x̂₁ and s⁴ + λ₃s³ + … + λ₀ as in `quadpend_baselines.estimation.observers`:

    x̂̇₁ = x̂₂ + λ₃ e,   x̂̇₂ = x̂₃ + λ₂ e [+ u],   x̂̇₃ = x̂₄ + λ₁ e,   x̂̇₄ = λ₀ e [+ u]   or   ρ sat(λ₀ e / ρ)

with the known input u into the state that it drives. The control law is that of `quadpend_baselines.controllers.adrc`, evaluated at every
stage of a classical Runge–Kutta step; commands saturate as the sampled controller's do.
"""

from typing import NamedTuple

import numpy as np
from tqdm.auto import tqdm

from quadpend_baselines.controllers.adrc import ADRC, AdrcMeasurement, AdrcMemory, make_measurement
from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, characteristic_polynomial
from quadpend_baselines.paper.trajectory import Trajectory
from quadpend_baselines.policy.protocol import to_action
from quadpend_gym import Reference, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations

_DRIVEN = np.array([LUENBERGER_INPUT, LUENBERGER_INPUT, ESO_INPUT, ESO_INPUT, ESO_INPUT, ESO_INPUT])
_OBSERVERS = np.arange(_DRIVEN.size)


class _Instant(NamedTuple):
    """What does not depend on the loop: derivatives of the reference, shape (7, 4), and the disturbance, shape (9,)."""

    reference: Floats
    disturbance: Floats


class _Loop(NamedTuple):
    """Plant and observers: shapes (18,) and (6, 4)."""

    state: Floats
    estimate: Floats

    def after(self, rate: "_Loop", time: float) -> "_Loop":
        """Where a constant rate of change leads."""
        return _Loop(self.state + time * rate.state, self.estimate + time * rate.estimate)


class ContinuousLoop:
    """Plant, observers and control law as one differential equation.

    Args:
        policy: the controller whose gains and law are used; its period does not matter.
    """

    def __init__(self, policy: ADRC) -> None:
        self.policy = policy
        gains = policy.gains
        observers = [gains.luenberger] * 2 + [gains.horizontal] * 2 + [gains.vertical] * 2
        self._gains = np.array([characteristic_polynomial(item)[1:] for item in observers])
        self._limits = np.array([item.switching for item in observers])
        for gain, item in zip(self._gains, observers, strict=True):
            if item.layer is not None:  # λ₀ becomes ρ/δ; the sign function is the limit of a thin layer
                gain[3] = item.switching / max(item.layer, 1e-300)

    def simulate(self, start: Floats, reference: Reference, disturbance: Floats, step: float, every: int) -> Trajectory:
        """Integrate and record.

        Args:
            start: shape (18,).
            reference: what to track.
            disturbance: the true one at every half step, shape (2 m + 1, 9), for m steps.
            step: of the integration, s.
            every: record one step in so many.
        """
        steps = disturbance.shape[0] // 2
        wanted = reference.derivatives(0.5 * step * np.arange(2 * steps + 1))
        instants = [_Instant(*pair) for pair in zip(wanted, disturbance, strict=True)]
        measurement, outputs = self._measure(start, instants[0])
        loop = _Loop(start, self.policy.initial_estimate(measurement, outputs)[0])
        records = []
        for i in tqdm(range(steps + 1), unit="step", unit_scale=True, leave=False, desc="continuous time"):
            if i % every == 0:
                records.append((loop.state, loop.estimate, self._act(loop, instants[2 * i])[2][0]))
            if i < steps:
                loop = self._advance(loop, instants[2 * i : 2 * i + 3], step)
        states, estimates, commands = (np.array(part) for part in zip(*records, strict=True))
        memory = AdrcMemory(estimates, commands, None)
        return Trajectory(
            step * every * np.arange(len(records), dtype=np.float64),
            states,
            wanted[:: 2 * every],
            commands,
            disturbance[:: 2 * every],
            self.policy.estimated_disturbance(memory),
        )

    def _advance(self, loop: _Loop, instants: list[_Instant], h: float) -> _Loop:
        """One Runge–Kutta step from the first instant over the middle one to the last; r back onto the sphere."""
        k1 = self._rate(loop, instants[0])
        k2 = self._rate(loop.after(k1, 0.5 * h), instants[1])
        k3 = self._rate(loop.after(k2, 0.5 * h), instants[1])
        k4 = self._rate(loop.after(k3, h), instants[2])
        for rate, share in ((k1, 1 / 6), (k2, 1 / 3), (k3, 1 / 3), (k4, 1 / 6)):
            loop = loop.after(rate, share * h)
        view = State(loop.state)
        view.direction[:] /= np.linalg.norm(view.direction)
        view.direction_rate[:] -= (view.direction @ view.direction_rate) * view.direction
        return loop

    def _measure(self, state: Floats, instant: _Instant) -> tuple[AdrcMeasurement, Floats]:
        wanted, view = instant.reference, State(state)
        bob = view.position + self.policy.simulation.parameters.rod_length * view.direction
        measurement = make_measurement(
            np.array([[bob[0], bob[1], view.position[2]]]) - wanted[0, :3],
            view.direction[np.newaxis],
            (view.euler - [0.0, 0.0, wanted[0, 3]])[np.newaxis],
            wanted[np.newaxis, :3, 3],
            wanted[np.newaxis, 2:, :3],
        )
        return measurement, self.policy.observer_outputs(measurement)

    def _act(self, loop: _Loop, instant: _Instant) -> tuple[AdrcMeasurement, Floats, Floats]:
        """What is measurement, what the observers compare it with, and the saturated command, shape (1, 4)."""
        measurement, outputs = self._measure(loop.state, instant)
        wish = self.policy.command(measurement, loop.estimate[np.newaxis])
        return measurement, outputs, to_action(wish, self.policy.simulation)[1]

    def _rate(self, loop: _Loop, instant: _Instant) -> _Loop:
        measurement, outputs, command = self._act(loop, instant)
        estimate = loop.estimate
        error = outputs[0] - estimate[:, 0]
        rate = self._gains * error[:, np.newaxis]
        rate[:, 3] = np.clip(rate[:, 3], -self._limits, self._limits)
        rate[:, :3] += estimate[:, 1:]
        rate[_OBSERVERS, _DRIVEN] += self.policy.observer_inputs(measurement, estimate[np.newaxis], command)[0]
        view = State(loop.state)
        second = accelerations(loop.state, command[0], instant.disturbance, self.policy.simulation.parameters)
        parts = [view.velocity, second.position, view.euler_rate, second.euler, view.direction_rate, second.direction]
        return _Loop(np.concatenate(parts), rate)
