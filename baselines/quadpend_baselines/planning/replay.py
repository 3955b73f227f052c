"""Fly an optimal flight through the environment, with a linear feedback of the deviations from it.

The pole is unstable: without feedback, the rounding of an action to float32 grows like e^(√K t), by e⁶⁸ in 10 s for the
paper's vehicle with √K = 6.76 1/s (K is `Parameters.chain_stiffness`). The feedback is that of a time-varying linear-
quadratic regulator along the flight. With the deviations z of the state of the plant and of the actions under way, and
the deviation c of the action,

    z_{k+1} = A_k z_k + B_k c_k,   c_k = −K_k z_k,   K_k = (R + B_kᵀ P_{k+1} B_k)⁻¹ B_kᵀ P_{k+1} A_k,
    P_k = Q + A_kᵀ P_{k+1} (A_k − B_k K_k),   P_N = Q.

It reads the true state, as nothing but the rounding has to be corrected.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpend_baselines.controllers.lqr import varying_gains
from quadpend_baselines.planning.episode import KnownEpisode
from quadpend_baselines.planning.transcription import Solution, Transcription
from quadpend_baselines.policy.protocol import Policy
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE

_STATE_WEIGHT = 1e4  # of Q = weight · 1, with R = 1: a deviation of 0.01 weighs as much as one of 1 in an action


@dataclass(frozen=True)
class TrackedFlight(Policy):
    """A policy that repeats an optimal flight in one sub-environment, from the start of its episode."""

    world: Any  # simulation of the sub-environment, whose true state is fed back
    states: Floats  # states x_k of the flight, shape (N + 1, 18)
    commands: Floats  # actions before their delay, shape (N, 4)
    A: Floats  # shape (N, n, n)
    B: Floats  # shape (N, n, 4)
    K: Floats  # shape (N, 4, n)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action, shape (1, 4); the memory is the number of the step and the deviations z."""
        step, rest = (0, np.zeros(self.A.shape[1] - STATE_SIZE)) if state is None else state
        z = np.concatenate([self.world.state[0] - self.states[step], rest])
        action = np.clip(self.commands[step] - self.K[step] @ z, -1.0, 1.0)
        following = self.A[step] @ z + self.B[step] @ (action - self.commands[step])
        return action[np.newaxis].astype(np.float32), (step + 1, following[STATE_SIZE:])


def track(solution: Solution, problem: Transcription, episode: KnownEpisode, world: Any) -> TrackedFlight:
    """Return the policy that flies a solution of a problem in the `World` of a sub-environment."""
    delay = problem.plant.delay
    A, B = _with_delay(*problem.linearise(episode, solution), delay)
    commands = np.vstack([solution.actions[delay:], np.zeros((delay, ACTION_SIZE))])
    Q = _STATE_WEIGHT * np.eye(A.shape[1])
    K = varying_gains(A, B, Q, np.eye(ACTION_SIZE), Q)
    return TrackedFlight(world, solution.states[:, :STATE_SIZE], commands, A, B, K)


def _with_delay(A: Floats, B: Floats, delay: int) -> tuple[Floats, Floats]:
    """Return A and B with the actions under way in the state, the one that acts next first."""
    if not delay:
        return A, B
    steps, n, under_way = len(A), A.shape[1], ACTION_SIZE * delay
    delayed_A, delayed_B = (
        np.zeros((steps, n + under_way, n + under_way)),
        np.zeros((steps, n + under_way, ACTION_SIZE)),
    )
    delayed_A[:, :n, :n], delayed_A[:, :n, n : n + ACTION_SIZE] = A, B
    delayed_A[:, n : n + under_way - ACTION_SIZE, n + ACTION_SIZE :] = np.eye(under_way - ACTION_SIZE)
    delayed_B[:, -ACTION_SIZE:] = np.eye(ACTION_SIZE)
    return delayed_A, delayed_B
