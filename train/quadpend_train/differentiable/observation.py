"""References, tracking errors, observation and margins of termination in PyTorch, with gradients, for n rows.

They are those of `quadpend_gym.tasks.references`, `quadpend_gym.tasks.observation` and `quadpend_gym.tasks.task`.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from quadpend_gym.tasks.observation import OBSERVATION_SCALE, REFERENCE_START
from quadpend_gym.tasks.references import CHANNELS
from quadpend_gym.tasks.task import Limits
from quadpend_train.differentiable.dynamics import Motion, thrust_axis

_TINY = 1e-12  # m², keeps the derivative of the norm finite at zero


def reference_derivatives(reference: Tensor, time: Tensor) -> Tensor:
    """Return the four channels of references and their first derivatives, shape (n, 2, 4).

    Args:
        reference: Laid out as `Reference.as_array`, shape (n, 20).
        time: s, shape (n,).
    """
    offset, rate, amplitude, frequency, phase = torch.split(reference, CHANNELS, dim=1)
    t = time[:, None]
    sine, cosine = torch.sin(frequency * t + phase), torch.cos(frequency * t + phase)
    return torch.stack([amplitude * sine + offset + rate * t, amplitude * frequency * cosine + rate], dim=1)


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
        reference: Channels and their derivatives from `reference_derivatives`, shape (n, 2, 4).
    """
    to_bob = rod_length * rod_length.new_tensor([1.0, 1.0, 0.0])  # the horizontal error is that of the bob
    return Tracking(
        motion.position + to_bob * motion.direction - reference[:, 0, :3],
        motion.velocity + to_bob * motion.direction_rate - reference[:, 1, :3],
        motion.euler[:, 2:] - reference[:, 0, 3:],
    )


def observe_state(motion: Motion, tracking: Tracking) -> Tensor:
    """Return the part of the observation that depends on the state, shape (n, 18)."""
    attitude = torch.cat([motion.euler[:, :2], tracking.yaw_error], dim=1)
    parts = (tracking.error, tracking.error_rate, motion.direction, motion.direction_rate, attitude, motion.euler_rate)
    observed = torch.cat(parts, dim=1)
    return observed / torch.as_tensor(OBSERVATION_SCALE[:REFERENCE_START], dtype=observed.dtype)


class Margins(NamedTuple):
    """Distances to the limits of a task, which are negative outside, each of shape (n, 1).

    Attributes:
        pendulum: (cos α − cos α_max) / (1 − cos α_max): 1 upright, 0 at the limit.
        body: The same for the tilt of the body.
        tracking: 1 − |e|/limit.
    """

    pendulum: Tensor
    body: Tensor
    tracking: Tensor


def limit_row(limits: Limits) -> list[float]:
    """Return the limits of a task as `margins` takes them: two cosines and a length in m."""
    return [math.cos(limits.pendulum_angle), math.cos(limits.body_angle), limits.tracking_error]


def margins(motion: Motion, tracking: Tracking, limits: Tensor) -> Margins:
    """Return the distances to the limits at which an episode terminates; `limits` has a `limit_row` for each row."""
    pendulum, body, largest = torch.split(limits, 1, dim=1)
    upright = motion.direction[:, 2:]
    return Margins(
        (upright - pendulum) / (1.0 - pendulum),
        (thrust_axis(motion.euler)[:, 2:] - body) / (1.0 - body),
        1.0 - torch.sqrt((tracking.error**2).sum(dim=1, keepdim=True) + _TINY) / largest,
    )
