"""References, tracking errors, observation and termination in PyTorch, with gradients, for n rows.

They are those of `quadpend_gym.tasks.references`, `quadpend_gym.tasks.observation` and `quadpend_gym.tasks.task`.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from quadpend_gym.tasks.observation import OBSERVATION_SCALE, REFERENCE_START
from quadpend_gym.tasks.references import CHANNELS, ORDERS
from quadpend_gym.tasks.task import Limits
from quadpend_train.differentiable.dynamics import Motion, thrust_axis

_TINY = 1e-12  # m², keeps the derivative of the norm finite at zero


def reference_derivatives(reference: Tensor, time: Tensor, orders: int = ORDERS) -> Tensor:
    """Return the four channels of references and their derivatives, shape (n, orders, 4).

    Args:
        reference: Laid out as `Reference.as_array`, shape (n, 20).
        time: s, shape (n,).
        orders: Number of derivatives, at least 2; the first is that of order 0.
    """
    offset, rate, amplitude, frequency, phase = torch.split(reference, CHANNELS, dim=1)
    t = time[:, None]
    sine, cosine = torch.sin(frequency * t + phase), torch.cos(frequency * t + phase)
    waves = (sine, cosine, -sine, -cosine)
    out = [amplitude * frequency**order * waves[order % 4] for order in range(orders)]
    out[0] = out[0] + offset + rate * t
    out[1] = out[1] + rate
    return torch.stack(out, dim=1)


class Tracking(NamedTuple):
    """Error of the flat outputs (m), its rate (m/s), both of shape (n, 3), and error of the yaw (rad), shape (n, 1)."""

    error: Tensor
    error_rate: Tensor
    yaw_error: Tensor


def tracking_errors(motion: Motion, rod_length: Tensor, reference: Tensor) -> Tracking:
    """Return the tracking errors.

    Args:
        motion: The motion.
        rod_length: l, m, shape (n, 1).
        reference: Channels and their derivatives from `reference_derivatives`, shape (n, k, 4) with k ≥ 2.
    """
    to_bob = rod_length * rod_length.new_tensor([1.0, 1.0, 0.0])  # the horizontal error is that of the bob
    return Tracking(
        motion.position + to_bob * motion.direction - reference[:, 0, :3],
        motion.velocity + to_bob * motion.direction_rate - reference[:, 1, :3],
        motion.euler[:, 2:] - reference[:, 0, 3:],
    )


def observe(motion: Motion, tracking: Tracking, reference: Tensor) -> Tensor:
    """Return the observation, shape (n, 36); `reference` is as in `tracking_errors`."""
    state_part = observe_state(motion, tracking)
    reference_part = torch.cat([reference[:, 2:, :3].flatten(1), reference[:, :3, 3]], dim=1)
    return torch.cat([state_part, reference_part / _scale(reference_part, REFERENCE_START, None)], dim=1)


def observe_state(motion: Motion, tracking: Tracking) -> Tensor:
    """Return the part of the observation that depends on the state, shape (n, 18)."""
    attitude = torch.cat([motion.euler[:, :2], tracking.yaw_error], dim=1)
    parts = (tracking.error, tracking.error_rate, motion.direction, motion.direction_rate, attitude, motion.euler_rate)
    observed = torch.cat(parts, dim=1)
    return observed / _scale(observed, 0, REFERENCE_START)


def _scale(like: Tensor, start: int, stop: int | None) -> Tensor:
    return torch.as_tensor(OBSERVATION_SCALE[start:stop], dtype=like.dtype)


class Margins(NamedTuple):
    """Distances to the limits of a task, which are negative outside, each of shape (n, 1).

    Attributes:
        pendulum: (cos α − cos α_max) / (1 − cos α_max): 1 upright, 0 at the limit.
        body: The same for the tilt of the body.
        tracking: 1 − |e|/limit.
        ground: Height of the lower of quadrotor and bob above the ground, m.
    """

    pendulum: Tensor
    body: Tensor
    tracking: Tensor
    ground: Tensor


def limit_row(limits: Limits) -> list[float]:
    """Return the limits of a task as `margins` takes them: two cosines and two lengths in m."""
    return [math.cos(limits.pendulum_angle), math.cos(limits.body_angle), limits.tracking_error, limits.ground]


def margins(motion: Motion, tracking: Tracking, rod_length: Tensor, limits: Tensor) -> Margins:
    """Return the distances to the limits at which an episode terminates.

    Args:
        motion: The motion.
        tracking: Its tracking errors.
        rod_length: l, m, shape (n, 1).
        limits: A `limit_row` of each row, shape (n, 4).
    """
    pendulum, body, largest, ground = torch.split(limits, 1, dim=1)
    height, upright = motion.position[:, 2:], motion.direction[:, 2:]
    return Margins(
        (upright - pendulum) / (1.0 - pendulum),
        (thrust_axis(motion.euler)[:, 2:] - body) / (1.0 - body),
        1.0 - torch.sqrt((tracking.error**2).sum(dim=1, keepdim=True) + _TINY) / largest,
        torch.minimum(height, height + rod_length * upright) - ground,
    )


def outside(margin: Margins) -> Tensor:
    """Return whether a row is outside the limits, shape (n,); touching the ground is outside."""
    negative = torch.cat(margin[:3], dim=1).amin(dim=1) < 0.0
    return negative | (margin.ground[:, 0] <= 0.0)
