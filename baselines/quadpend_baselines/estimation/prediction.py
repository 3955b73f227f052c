"""Prediction of the state: the nonlinear simulation, driven by the action that passes through the known loop.

    (1)  x_{k+1} = f(x_k, ā_k, d̂, μ̂),   ā_k = h(a_k, a_{k−1}, …)          f: one control period, h: `loop.Loop`

Positions and velocities are relative to the reference, which accelerates. The prediction therefore subtracts the motion
of the reference over a period, a polynomial of order 6. The state of a rigid vehicle includes the thrusts of its
rotors, which are predicted without correction; f delays the action by the latency of the simulation.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.modelling.planar import limit_norm
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import State
from quadpend_gym.vehicles.parameters import BOB_MASS, QUADROTOR_MASS

_MAX_HORIZONTAL = 0.95  # bound of |r_xy| of an estimate: 72° from upright; the default limit of an episode is 60°

MASSES = [QUADROTOR_MASS, BOB_MASS]


class Measurement(NamedTuple):
    """Observations of n rows, converted for the estimator."""

    # Layout of `quadpend_gym.physics.state`, shape (n, 18); position and velocity are relative to the reference, and
    # rates that are not measured are nan
    state: Floats
    reference: Floats  # F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3)
    yaw_reference: Floats  # ψ_d, ψ̇_d, ψ̈_d, in rad, rad/s and rad/s², shape (n, 3)


class Estimate(NamedTuple):
    """Memory of the estimator for n rows."""

    state: Floats  # x̂, as `Measurement.state` but complete, shape (n, 18)
    disturbance: Floats  # d̂, in the layout of `Disturbance`, N and N·m, shape (n, 9)
    reference: Floats  # reference derivatives of the latest measurement, shape (n, 5, 3)
    age: Integers  # number of corrections since the episode began, shape (n,)
    loop: Floats  # memory of the known loop, shape (n, k), see `Loop.act`
    # Quaternion, body rate and rotor thrusts (N) of a rigid vehicle, shape (n, 11), see
    # `quadpend_gym.physics.rigid_kernel`; shape (n, 0) for the paper's attitude model
    rigid: Floats
    # μ̂, effective ratio of weight to thrust, which scales the masses of quadrotor and bob, shape (n,)
    mass_ratio: Floats
    # Measured minus predicted state before the latest correction, shape (n, 18); zero where a rate is not measured and
    # at the start of an episode. Empty for observers without it.
    innovation: Any = ()


@dataclass(frozen=True)
class Prediction:
    """Equation (1)."""

    simulation: Simulation  # nominal plant and control period
    known_loop: Loop  # the known part of the loop, without the latency of the simulation
    predicts_latency: bool = True  # whether the latency is known

    @cached_property
    def loop(self) -> Loop:
        """The known part of the loop, with the whole periods of the latency."""
        return replace(self.known_loop, delay=self.known_loop.delay + self._latency[0])

    @cached_property
    def _latency(self) -> tuple[int, int]:
        """The latency in whole control periods and the remaining substeps."""
        delayed = self.simulation.delayed_substeps if self.predicts_latency else 0
        return delayed // self.simulation.substeps, delayed % self.simulation.substeps

    @cached_property
    def memory_size(self) -> int:
        """Length of a row of `Estimate.loop`.

        If the latency is not a whole number of periods, the last action follows the memory of the loop.
        """
        return self.loop.memory_size + (4 if self._latency[1] else 0)

    def rigid(self, state: Floats, thrusts: Floats | None = None) -> Floats:
        """Return `Estimate.rigid` of states, shape (n, 18), with rotor thrusts, N, shape (n, 4), or those at hover."""
        rigid = plant_of(self.simulation).initial_memory(state)
        if thrusts is not None:
            rigid[:, ROTOR_THRUST:] = thrusts
        return rigid

    def advance(self, estimate: Estimate, action: Floats32) -> Estimate:
        """Return the estimate one control period later, without a correction; its reference moves along."""
        return self._advance(estimate, action, self.simulation)

    def _advance(self, estimate: Estimate, action: Floats32, simulation: Simulation) -> Estimate:
        """Advance by the period of `simulation`, which may differ from the control period."""
        action, memory = self.loop.act(action, estimate.loop[:, : self.loop.memory_size], simulation)
        state, rigid, switch = estimate.state.copy(), estimate.rigid.copy(), self._latency[1]
        parameters = np.tile(self.simulation.parameters.as_array(), (len(state), 1))
        parameters[:, MASSES] *= estimate.mass_ratio[:, np.newaxis]
        before = np.ascontiguousarray(estimate.loop[:, -4:]) if switch else None
        plant_of(simulation).advance(state, rigid, action, estimate.disturbance, parameters, before, switch)
        if switch:
            memory = np.concatenate([memory, action], axis=1)
        s = State(state)
        for order, derivative in enumerate(np.moveaxis(estimate.reference, 1, 0), 2):
            s.position[:] -= simulation.period**order / factorial(order) * derivative
            s.velocity[:] -= simulation.period ** (order - 1) / factorial(order - 1) * derivative
        reference = shift_polynomial(estimate.reference, simulation.period)
        return estimate._replace(state=state, reference=reference, age=estimate.age + 1, loop=memory, rigid=rigid)

    def carry_forward(
        self, estimate: Estimate, action: Floats32, measurement: Measurement
    ) -> tuple[Estimate, Measurement]:
        """Return estimate and measurement at the time when the next action acts.

        Args:
            estimate: The latest estimate.
            action: The latest action that the controller has chosen, shape (n, 4); it is taken to continue while a lag
                of the actuators is predicted through.
            measurement: The latest measurement. Only its reference is carried forward.
        """
        substep = self.simulation.period / self.simulation.substeps
        substeps = [self.simulation.substeps] * self.loop.steps
        rest = self._latency[1] + round(self.loop.lag / substep)
        while rest > 0:
            substeps.append(min(rest, self.simulation.substeps))
            rest -= substeps[-1]
        if not substeps:
            return estimate, measurement
        for number in substeps:
            part = self.simulation
            if number < part.substeps:
                part = replace(part, period=number * substep, substeps=number, latency=0.0)
            estimate = self._advance(estimate, action, part)
        project_direction(estimate.state)
        yaw_reference = shift_polynomial(measurement.yaw_reference, sum(substeps) * substep)
        return estimate, measurement._replace(reference=estimate.reference, yaw_reference=yaw_reference)


def project_direction(state: Floats) -> None:
    """Limit |r_xy|, and set r_z and ṙ_z in place such that |r| = 1, r_z > 0 and r·ṙ = 0."""
    s = State(state)
    s.direction[:, :2] = limit_norm(s.direction[:, :2], _MAX_HORIZONTAL)
    s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
    along = np.sum(s.direction[:, :2] * s.direction_rate[:, :2], axis=1)
    s.direction_rate[:, 2] = -along / s.direction[:, 2]


def shift_polynomial(derivatives: Floats, time: float) -> Floats:
    """Return the successive derivatives of a polynomial, shape (n, k, …), a time (s) later."""
    orders = derivatives.shape[1]
    out = derivatives.copy()
    for power in range(1, orders):
        out[:, : orders - power] += time**power / factorial(power) * derivatives[:, power:]
    return out
