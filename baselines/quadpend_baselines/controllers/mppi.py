"""Sampling-based model-predictive control: MPPI (Williams, Aldrich & Theodorou, JGCD 2017) around a linear feedback.

At every control step, the compiled rollout of `mppi_kernel` simulates `samples` trajectories of each row with the
kernel of the environment and the estimated disturbance, over `horizon` periods of `steps_per_period` · 0.01 s. So the
horizon has the same length in seconds at any control period.

    (1)  u_j = sat(u_d − K (x_j − x_d) + δ_j),         δ piecewise linear between `knots`, δᵏ = δ + εᵏ
    (2)  Jᵏ  = ½ Σ ((x_j − x_d)ᵀ Q (x_j − x_d) + (u_j − u_d)ᵀ R (u_j − u_d)) + barrier + ½ (x_H − x_d)ᵀ P (x_H − x_d)
    (3)  δ  ← Σ wᵏ δᵏ,                                wᵏ ∝ exp(−(Jᵏ − min J) / (λ (mean J − min J)))

The command is (1) at j = 0 with the updated δ. x_d and u_d are the trajectory of `flat_outputs` under that disturbance.
K, Q, R and P are those of `lqr`, sampled with the period of the horizon. One sample has δ = 0, which is
the linear feedback alone. The barrier penalises states close to an early termination. ε comes from fixed tables, so the
controller is deterministic.

Rollout and weights of a rigid vehicle are those of the equivalent pendulum with the paper's attitude model
(`modelling.equivalent`), without the height of the pivot and the lag of the rotors.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quadpend_baselines.controllers import mppi_kernel
from quadpend_baselines.controllers.lqr import riccati, weights
from quadpend_baselines.controllers.reference_horizon import Horizon, reference_horizon
from quadpend_baselines.estimation.estimator import Estimate
from quadpend_baselines.gains import MppiGains
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS, rotate_state
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.physics.state import COMMAND_SIZE, State
from quadpend_gym.vehicles import CONTROL_PERIOD

_TABLES = 64  # number of tables of perturbations, used in turn


class MppiMemory(NamedTuple):
    """Memory of MPPI for n rows."""

    perturbation: Floats  # δ at the knots, N and N·m, shape (n, knots, 4)
    updates: Integers  # number of updates of δ since the episode began, shape (n,)


@dataclass(frozen=True)
class Mppi:
    """The control law (1)–(3)."""

    gains: MppiGains
    simulation: Simulation

    @cached_property
    def horizon_simulation(self) -> Simulation:
        """The simulation with the period of the horizon."""
        steps, design = self.gains.steps_per_period, equivalent_model(self.simulation).simulation
        return replace(design, period=CONTROL_PERIOD * steps, substeps=steps)

    @cached_property
    def perturbations(self) -> Floats:
        """ε of equation (1), N and N·m, shape (64, samples − 1, knots, 4); the sum over the samples is zero."""
        g = self.gains
        half = np.random.default_rng(0).standard_normal((_TABLES, (g.samples - 1) // 2, g.knots, COMMAND_SIZE))
        return np.concatenate([half, -half], axis=1) * (g.spread * self.horizon_simulation.command_scale)

    def initial_memory(self, rows: int) -> MppiMemory:
        """Return δ = 0."""
        return MppiMemory(np.zeros((rows, self.gains.knots, COMMAND_SIZE)), np.zeros(rows, np.int64))

    def command(self, estimate: Estimate, memory: MppiMemory) -> tuple[Floats, MppiMemory]:
        """Return the command and the memory of equations (1)–(3); see `output_feedback.ControlLaw`."""
        period, steps = self.horizon_simulation.period, self.gains.horizon
        horizon = reference_horizon(estimate, self.simulation, period, steps)
        samples = memory.perturbation[:, np.newaxis] + self.perturbations[memory.updates % _TABLES]
        samples = np.concatenate([np.zeros_like(samples[:, :1]), samples], axis=1)
        cost = self.costs(estimate, horizon, samples)
        excess = cost - cost.min(axis=1, keepdims=True)
        scale = self.gains.temperature * excess.mean(axis=1, keepdims=True)
        weight = np.exp(-excess / np.maximum(scale, 1e-12))
        weight /= weight.sum(axis=1, keepdims=True)
        perturbation = np.einsum("nk,nkmc->nmc", weight, samples)
        gain, _ = riccati(self.gains.feedback, self.horizon_simulation)
        yaw = State(estimate.state).euler[:, 2]
        error = rotate_state((estimate.state - horizon.state[0])[:, STATE_COLUMNS], -yaw)
        command = horizon.command[0] - error @ gain.T + perturbation[:, 0]
        # The knots move forward by one control step.
        knot_spacing = period * steps / (self.gains.knots - 1)
        share = self.simulation.period / knot_spacing
        next_knot = np.concatenate([perturbation[:, 1:], np.zeros_like(perturbation[:, :1])], axis=1)
        command = equivalent_model(self.simulation).body_command(estimate.state, command, estimate.disturbance)
        return command, MppiMemory(perturbation + share * (next_knot - perturbation), memory.updates + 1)

    def costs(self, estimate: Estimate, horizon: Horizon, samples: Floats) -> Floats:
        """Return J of equation (2), shape (n, samples), for δᵏ, N and N·m, shape (n, samples, knots, 4)."""
        simulation, feedback = self.horizon_simulation, self.gains.feedback
        gain, terminal_weight = riccati(feedback, simulation)
        state_weight, command_weight = weights(feedback, simulation)
        limits = simulation.command_scale * [[0.0, -1.0, -1.0, -1.0], [2.0, 1.0, 1.0, 1.0]]
        return mppi_kernel.costs(
            estimate.state,
            equivalent_model(self.simulation).disturbance(estimate.disturbance),
            simulation.parameters.as_array(),
            np.ascontiguousarray(horizon.state[..., STATE_COLUMNS]),
            horizon.command,
            horizon.frame_displacement,
            np.ascontiguousarray(np.moveaxis(samples, 1, -1)),
            gain,
            state_weight,
            command_weight,
            terminal_weight,
            limits,
            simulation.period,
            simulation.substeps,
        )
