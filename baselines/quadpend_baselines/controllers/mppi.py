"""Sampling-based model-predictive control: MPPI (Williams, Aldrich & Theodorou, JGCD 2017) around a linear feedback.

At every control step the project's own kernel flies `samples` futures of each row in a batch, over `horizon` periods
of `steps_per_period` control steps each, with the wind that is estimated:

    (1)  u_j = sat(u_d − K (x_j − x_d) + δ_j),         δ piecewise linear between `knots`, δᵏ = δ + εᵏ
    (2)  Jᵏ  = ½ Σ ((x_j − x_d)ᵀ Q (x_j − x_d) + (u_j − u_d)ᵀ R (u_j − u_d)) + barrier + ½ (x_H − x_d)ᵀ P (x_H − x_d)
    (3)  δ  ← Σ wᵏ δᵏ,                                wᵏ ∝ exp(−(Jᵏ − min J) / (λ (mean J − min J)))

and (1) with the first of the new δ is what acts. x_d and u_d are the flight of `flat_outputs` in that wind; K, Q, R, P
those of `lqr`, sampled with the period of the horizon. One future has no δ: what the linear feedback does well, it goes
on doing. The barrier stands where episodes end. ε is drawn from a fixed table, so the controller is a function of what
it observes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import NamedTuple

import numpy as np

from quadpend_baselines.controllers import mppi_kernel
from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.estimation.estimator import Estimate, Measurement
from quadpend_baselines.gains import MppiGains
from quadpend_baselines.modelling import flat_outputs
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.validation import check_int
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE

_TABLES = 64  # of perturbations, one after the other


class Horizon(NamedTuple):
    """Where n rows should be at the periods 0 … H of the horizon."""

    state: Floats  # x_d, in the reference's frame, (H + 1, n, 18)
    command: Floats  # u_d, (H + 1, n, 4)
    frame_displacement: (
        Floats  # how far the frame moves in each period: what to take off position and velocity, (H, 2, n, 3)
    )


class MppiMemory(NamedTuple):
    """δ at the knots, in N and N·m, shape (n, knots, 4), and the number of plans made, shape (n,)."""

    plan: Floats
    number: Integers


@dataclass(frozen=True)
class Mppi:
    """The law (1)–(3)."""

    gains: MppiGains
    simulation: Simulation

    def __post_init__(self) -> None:
        g = self.gains
        if not (3 <= g.samples <= mppi_kernel.LARGEST and g.samples % 2):
            raise ValueError(f"samples must be odd and from 3 to {mppi_kernel.LARGEST - 1}, not {g.samples!r}")
        for name, least in (("horizon", 1), ("steps_per_period", 1), ("knots", 2)):
            check_int(getattr(g, name), name, least)
        if g.feedback.integral > 0.0:
            raise ValueError("the feedback of MPPI has no integrators: its integral must be 0")

    @cached_property
    def _coarse(self) -> Simulation:
        sim = self.simulation
        return replace(
            sim,
            period=sim.period * self.gains.steps_per_period,
            substeps=max(1, sim.substeps * self.gains.steps_per_period // 2),
        )

    @cached_property
    def _noise(self) -> Floats:
        """ε of equation (1), shape (64, samples − 1, knots, 4); every perturbation has its opposite."""
        g = self.gains
        half = np.random.default_rng(0).standard_normal((_TABLES, (g.samples - 1) // 2, g.knots, 4))
        return np.concatenate([half, -half], axis=1) * (g.spread * self.simulation.command_scale)

    def initial_memory(self, rows: int) -> MppiMemory:
        """δ = 0."""
        return MppiMemory(np.zeros((rows, self.gains.knots, COMMAND_SIZE)), np.zeros(rows, np.int64))

    def command(self, estimate: Estimate, measurement: Measurement, memory: MppiMemory) -> tuple[Floats, MppiMemory]:
        """Equations (1)–(3); see `observed.ControlLaw`."""
        horizon = self._look_ahead(estimate, measurement)
        plans = memory.plan[:, np.newaxis] + self._noise[memory.number % _TABLES]
        plans = np.concatenate([np.zeros_like(plans[:, :1]), plans], axis=1)
        cost = self._cost(estimate, horizon, plans)
        above = cost - cost.min(axis=1, keepdims=True)
        scale = self.gains.temperature * above.mean(axis=1, keepdims=True)
        weight = np.exp(-above / np.maximum(scale, 1e-12))
        weight /= weight.sum(axis=1, keepdims=True)
        plan = np.einsum("nk,nkmc->nmc", weight, plans)
        gain, _ = riccati(self.gains.feedback, self._coarse)
        error = rotate_state((estimate.state - horizon.state[0])[:, STATE_COLUMNS], -estimate.state[:, 8])
        command = horizon.command[0] - error @ gain.T + plan[:, 0]
        share = self.simulation.period / (self._coarse.period * self.gains.horizon / (self.gains.knots - 1))
        later = np.concatenate([plan[:, 1:], np.zeros_like(plan[:, :1])], axis=1)
        return command, MppiMemory(plan + share * (later - plan), memory.number + 1)

    def _look_ahead(self, estimate: Estimate, measurement: Measurement) -> Horizon:
        p, steps, period = self.simulation.parameters, self.gains.horizon + 1, self._coarse.period
        rows = len(measurement.state)
        time = period * np.arange(steps)
        derivatives = np.moveaxis(measurement.reference, 1, 0)
        later = np.zeros((steps, *derivatives.shape))
        for order in range(len(derivatives)):
            for more in range(len(derivatives) - order):
                factor = time**more / factorial(more)
                later[:, order] += factor[:, np.newaxis, np.newaxis] * derivatives[order + more]
        yaw, rate, acceleration = (measurement.yaw_reference[:, i] for i in range(3))
        t = time[:, np.newaxis]
        yaws = np.stack(
            np.broadcast_arrays(yaw + t * rate + t**2 / 2 * acceleration, rate + t * acceleration, acceleration), -1
        )
        wind = np.tile(estimate.disturbance, (steps, 1))
        flight = flat_outputs.flat_trajectory(
            np.moveaxis(later, 2, 1).reshape(-1, *measurement.reference.shape[1:]), wind, p
        )
        state, command = flat_outputs.state_and_command(flight, yaws.reshape(-1, 3), wind, p)
        frame_displacement = [
            sum(period ** (i + 2 - less) / factorial(i + 2 - less) * later[:-1, i] for i in range(len(derivatives)))
            for less in (0, 1)
        ]
        return Horizon(
            state.reshape(steps, rows, STATE_SIZE),
            command.reshape(steps, rows, -1),
            np.stack(frame_displacement, axis=1),
        )

    def _cost(self, estimate: Estimate, horizon: Horizon, plans: Floats) -> Floats:
        """J of equation (2) for each plan, shape (n, samples)."""
        coarse, feedback = self._coarse, self.gains.feedback
        gain, terminal = riccati(feedback, coarse)
        weigh, effort = weights(feedback, coarse)
        limits = coarse.command_scale * [[0.0, -1.0, -1.0, -1.0], [2.0, 1.0, 1.0, 1.0]]
        return mppi_kernel.costs(
            estimate.state,
            estimate.disturbance,
            coarse.parameters.as_array(),
            np.ascontiguousarray(horizon.state[..., STATE_COLUMNS]),
            horizon.command,
            horizon.frame_displacement,
            np.ascontiguousarray(np.moveaxis(plans, 1, -1)),
            gain,
            weigh,
            effort,
            terminal,
            limits,
            coarse.period,
            coarse.substeps,
        )
