"""Settings of the algorithms, each in a table of its own."""

from dataclasses import dataclass
from typing import Annotated

from quadpend_gym.core.ranges import Range, check_fields


@dataclass(frozen=True)
class PpoSettings:
    """Settings of PPO only."""

    n_steps: Annotated[int, Range(1, 100_000)] = 64
    """Steps of each sub-environment per rollout."""
    n_epochs: Annotated[int, Range(1, 1000)] = 3
    """Epochs of optimisation per rollout."""
    gae_lambda: Annotated[float, Range(0.0, 1.0)] = 0.95
    """Factor λ of generalised advantage estimation."""
    clip_range: Annotated[float, Range(1e-6, 100.0)] = 0.2
    """Clipping range of the probability ratio of new and old policy."""
    ent_coef: Annotated[float, Range(0.0, 1000.0)] = 0.0
    """Coefficient of the entropy bonus in the loss."""
    log_std_init: Annotated[float, Range(-20.0, 5.0)] = 0.0
    """Initial logarithm of the standard deviation of the action noise."""
    critic_warmup_steps: Annotated[int, Range(0, 1e12)] = 0
    """Timesteps at the beginning in which only the critic is trained, for policies that perform well from the start."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class SacSettings:
    """Settings of SAC and TQC only."""

    gradient_steps: Annotated[int, Range(1, 10_000)] = 4
    """Gradient steps per step of the vector environment."""
    buffer_size: Annotated[int, Range(1, 100_000_000)] = 300_000
    """Size of the replay buffer in transitions."""
    learning_starts: Annotated[int, Range(1, 1e12)] = 10_000
    """Timesteps with random actions before training begins."""
    tau: Annotated[float, Range(0.0, 1.0)] = 0.005
    """Polyak coefficient τ of the target network update."""
    ent_coef_init: Annotated[float, Range(1e-9, 1e6)] = 0.1
    """Initial value of the entropy coefficient, which is learned."""
    target_entropy: Annotated[float, Range(-1000.0, 1000.0)] = -4.0
    """Target entropy of the policy; the entropy coefficient is adjusted to reach it."""

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class ApgSettings:
    """Settings of APG only; its module explains the cost."""

    window: Annotated[int, Range(1, 10_000)] = 100
    """Control steps through which gradients are propagated; one gradient step per window."""
    restart: Annotated[float, Range(0.0, 1.0)] = 0.5
    """Share of the rows of each scenario that begin a new episode with each window, rounded to whole rows."""
    rmse: Annotated[float, Range(0.0, 1e6, "1/m")] = 6.0
    """Weight w_R of the root mean square of the tracking error, mean over the scenarios, 1/m."""
    error: Annotated[float, Range(0.0, 1e6, "1/m")] = 0.1
    """Weight w₁ of the tracking error, 1/m."""
    yaw: Annotated[float, Range(0.0, 1e6, "1/rad²")] = 0.1
    """Weight w_ψ of the squared yaw error, 1/rad²."""
    effort: Annotated[float, Range(0.0, 1e6)] = 1e-3
    """Weight w_a of the squared actions."""
    rate: Annotated[float, Range(0.0, 1e6, "s²/rad²")] = 1e-4
    """Weight w_ω of the squared Euler-angle rates, s²/rad²."""
    lean: Annotated[float, Range(0.0, 1e6)] = 100.0
    """Weight w_l of the cost of leaning."""
    max_grad_norm: Annotated[float, Range(1e-9, 1e9)] = 1.0
    """Largest norm of the gradient of a gradient step."""
    max_state_gradient: Annotated[float, Range(1e-9, 1e12)] = 3000.0
    """Largest norm of the gradient of the summed cost of a row with respect to its state at one step."""

    def __post_init__(self) -> None:
        check_fields(self)
